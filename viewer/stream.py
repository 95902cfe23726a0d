"""One stream of frames for every page: made once per turn, and only while somebody waits for it."""

import asyncio
from collections.abc import Callable
from typing import Final

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

PERIOD_S: Final = 0.04
#: Frames on their way to one page at most; the page acknowledges each, so that a slow one skips frames.
ON_THE_WAY: Final = 2


class FrameStream:
    """Hands the newest frame, at most one per `period_s`, to everyone who waits.

    Parameters
    ----------
    make : callable
        Returns the frame of this instant.
    """

    def __init__(self, make: Callable[[], bytes], period_s: float = PERIOD_S) -> None:
        self._make = make
        self._period_s = period_s
        self._waiting: list[asyncio.Future[bytes]] = []

    async def run(self) -> None:
        """Make frames until cancelled."""
        while True:
            await asyncio.sleep(self._period_s)
            waiting, self._waiting = self._waiting, []
            if waiting:
                content = self._make()
                for future in waiting:
                    if not future.done():
                        future.set_result(content)

    async def next(self) -> bytes:
        """Wait for the next frame."""
        future: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
        self._waiting.append(future)
        return await future


async def serve_page(websocket: WebSocket, stream: FrameStream) -> None:
    """Send frames to one page until it leaves, never more than it keeps up with."""
    credit = asyncio.BoundedSemaphore(ON_THE_WAY)
    sending = asyncio.create_task(_send(websocket, stream, credit))
    try:
        while True:
            await websocket.receive_text()
            credit.release()
    except (WebSocketDisconnect, ValueError, KeyError):
        pass  # it left, acknowledged what was never sent, or sent bytes: either way it is not served any more
    finally:
        sending.cancel()
        await asyncio.gather(sending, return_exceptions=True)
    if websocket.client_state is WebSocketState.CONNECTED:
        await websocket.close(code=1008)


async def _send(websocket: WebSocket, stream: FrameStream, credit: asyncio.BoundedSemaphore) -> None:
    while True:
        await credit.acquire()
        await websocket.send_bytes(await stream.next())

"""One stream of frames for all pages: one frame per period, and none while no page waits."""

import asyncio
from collections.abc import Callable
from typing import Final

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

PERIOD_S: Final = 0.04
#: Most unacknowledged frames of one page; a slow page skips frames.
ON_THE_WAY: Final = 2


class FrameStream:
    """Gives the newest frame to all pages that wait, at most one frame per `period_s`, from the first page on.

    Parameters
    ----------
    make : callable
        Returns the present frame.
    """

    def __init__(self, make: Callable[[], bytes], period_s: float = PERIOD_S) -> None:
        self._make = make
        self._period_s = period_s
        self._waiting: list[asyncio.Future[bytes]] = []
        self._running: asyncio.Task[None] | None = None
        self._is_closed = False

    def close(self) -> None:
        """Make no more frames: pages connect again after a silence. From any thread."""
        self._is_closed = True

    async def _run(self) -> None:
        clock_s = asyncio.get_running_loop().time
        due_s = clock_s()
        while not self._is_closed:
            due_s = max(due_s + self._period_s, clock_s())  # by an absolute clock: lateness is made up
            await asyncio.sleep(due_s - clock_s())
            waiting, self._waiting = self._waiting, []
            if waiting:
                content = self._make()
                for future in waiting:
                    if not future.done():
                        future.set_result(content)

    async def next(self) -> bytes:
        """Wait for the next frame."""
        if self._running is None:
            self._running = asyncio.create_task(self._run())
        future: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
        self._waiting.append(future)
        return await future


async def serve_page(websocket: WebSocket, stream: FrameStream) -> None:
    """Send frames to one page until it disconnects, no faster than it acknowledges them."""
    credit = asyncio.BoundedSemaphore(ON_THE_WAY)
    sending = asyncio.create_task(_send(websocket, stream, credit))
    try:
        while True:
            await websocket.receive_text()
            credit.release()
    except (WebSocketDisconnect, ValueError, KeyError):
        pass  # the page has disconnected, acknowledged too often, or sent bytes: it is served no more
    finally:
        sending.cancel()
        await asyncio.gather(sending, return_exceptions=True)
    if websocket.client_state is WebSocketState.CONNECTED:
        await websocket.close(code=1008)


async def _send(websocket: WebSocket, stream: FrameStream, credit: asyncio.BoundedSemaphore) -> None:
    while True:
        await credit.acquire()
        await websocket.send_bytes(await stream.next())

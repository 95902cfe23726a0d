"""Latest wins: a slow page skips frames and keeps nobody waiting."""

import asyncio
from itertools import count

from starlette.websockets import WebSocketDisconnect, WebSocketState

from views.page.stream import ON_THE_WAY, FrameStream, serve_page


class Page:
    """A WebSocket whose page acknowledges only when it is told to."""

    def __init__(self) -> None:
        self.client_state = WebSocketState.CONNECTED
        self.got: asyncio.Queue[bytes] = asyncio.Queue()
        self.said: asyncio.Queue[str | None] = asyncio.Queue()

    async def send_bytes(self, content: bytes) -> None:
        self.got.put_nowait(content)

    async def receive_text(self) -> str:
        said = await self.said.get()
        if said is None:
            self.client_state = WebSocketState.DISCONNECTED
            raise WebSocketDisconnect
        return said

    async def close(self, code: int) -> None:
        self.client_state = WebSocketState.DISCONNECTED


async def two_pages() -> tuple[int, list[int]]:
    """Serve a page that follows and one that does not; return the last frame sent and what the slow one got."""
    numbers = count(1)
    stream = FrameStream(lambda: b"%d" % next(numbers), period_s=0.001)
    quick, slow = Page(), Page()
    tasks = [
        asyncio.create_task(serve_page(quick, stream)),  # type: ignore[arg-type]  # what serve_page needs of it
        asyncio.create_task(serve_page(slow, stream)),  # type: ignore[arg-type]  # what serve_page needs of it
    ]
    newest = 0
    for _ in range(50):
        newest = int(await quick.got.get())
        quick.said.put_nowait("ok")
    early = [int(slow.got.get_nowait()) for _ in range(slow.got.qsize())]
    slow.said.put_nowait("ok")
    early.append(int(await slow.got.get()))
    for page in (quick, slow):
        page.said.put_nowait(None)
    await asyncio.gather(*tasks)
    return newest, early


def test_slow_page_skips_frames_and_the_quick_one_does_not_wait() -> None:
    newest, slow = asyncio.run(two_pages())
    assert newest >= 50
    assert len(slow) == ON_THE_WAY + 1
    assert slow[:ON_THE_WAY] == [1, 2]
    assert slow[-1] >= newest


def test_no_frame_is_made_for_nobody() -> None:
    async def idle() -> int:
        made = count()
        stream = FrameStream(lambda: b"%d" % next(made), period_s=0.0)
        assert await stream.next() == b"0"
        for _ in range(20):
            await asyncio.sleep(0)
        stream.close()
        return next(made)

    assert asyncio.run(idle()) == 1

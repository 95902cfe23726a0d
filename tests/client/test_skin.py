"""Readers of frames: the newest, or all through a queue; with for and with async for."""

import asyncio
import threading
from types import SimpleNamespace

import pytest

from canskin.errors import BusError
from canskin.frame import Frame, FrameBuilder
from canskin.skin import FrameHub, Frames
from tests.client.helpers import contacts, description, image
from tests.processes import PATIENCE_S


def frame(cycle: int) -> Frame:
    builder = FrameBuilder(description())
    builder.take(image(cycle))
    return builder.take(contacts(cycle))[0]


@pytest.fixture
def hub() -> FrameHub:
    return FrameHub(0.05, lambda: "nothing came")


def test_a_slow_reader_has_the_newest_frame_and_knows_how_many_it_lost(hub: FrameHub) -> None:
    reader = hub.frames(1)
    for cycle in (1, 2, 3):
        hub.put(frame(cycle))
    assert next(reader).cycle == 3
    assert reader.lost == 2


def test_a_queue_holds_all_up_to_its_length_for_each_reader(hub: FrameHub) -> None:
    short, long = hub.frames(2), hub.frames(10)
    for cycle in (1, 2, 3):
        hub.put(frame(cycle))
    hub.close()
    assert [each.cycle for each in short] == [2, 3]
    assert [each.cycle for each in long] == [1, 2, 3]
    assert (short.lost, long.lost) == (1, 0)


def test_silence_is_an_error_that_explains(hub: FrameHub) -> None:
    with pytest.raises(BusError, match="nothing came"):
        next(hub.frames(1))
    with pytest.raises(BusError, match="nothing came"):
        hub.latest(1.0)

    async def read() -> None:
        await anext_of(hub.frames(1))

    with pytest.raises(BusError, match="nothing came"):
        asyncio.run(read())


async def anext_of(reader: Frames) -> Frame:
    return await reader.__anext__()


def test_the_latest_frame_is_given_while_it_is_young_enough(hub: FrameHub) -> None:
    hub.put(frame(1))  # long ago: the clock of the other machine
    with pytest.raises(BusError):
        hub.latest(1.0)
    assert hub.latest(float("inf")).cycle == 1


def test_images_that_are_too_old_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    hub = FrameHub(1.0, lambda: "nothing came")
    times_s = iter((0.0, 0.999, 2.0))  # of the beginning, and after a look at the frame before and at the newest

    def monotonic() -> float:
        hub.put(frame(hub.count + 1))
        return next(times_s)

    monkeypatch.setattr("canskin.skin.time", SimpleNamespace(monotonic=monotonic))
    with pytest.raises(BusError, match=r"the newest image is .* s old, asked for 0 s at most"):
        hub.latest(0.0)


def test_a_reader_that_waits_is_woken() -> None:
    hub = FrameHub(PATIENCE_S, lambda: "nothing came")
    reader = hub.frames(1)
    later = threading.Timer(0.01, hub.put, (frame(4),))
    later.start()
    assert next(reader).cycle == 4
    later.join()


def test_async_readers_get_each_frame_and_end_with_the_skin() -> None:
    hub = FrameHub(PATIENCE_S, lambda: "nothing came")

    async def read() -> list[int]:
        reader = hub.frames(10)
        hub.put(frame(1))
        feeding = threading.Thread(target=lambda: (hub.put(frame(2)), hub.put(frame(3)), hub.close()))
        feeding.start()
        found = [each.cycle async for each in reader]
        feeding.join()
        return found

    assert asyncio.run(read()) == [1, 2, 3]


def test_a_cancelled_wait_loses_no_frame() -> None:
    hub = FrameHub(PATIENCE_S, lambda: "nothing came")

    async def read() -> int:
        reader = hub.frames(4)
        waiting = asyncio.ensure_future(anext_of(reader))
        await asyncio.sleep(0)
        waiting.cancel()
        await asyncio.gather(waiting, return_exceptions=True)
        hub.put(frame(7))
        return (await anext_of(reader)).cycle

    assert asyncio.run(read()) == 7


def test_a_closed_reader_gets_no_more_frames(hub: FrameHub) -> None:
    reader = hub.frames(4)
    hub.put(frame(1))
    reader.close()
    hub.put(frame(2))
    assert [each.cycle for each in reader] == [1]


def test_after_the_end_nothing_waits(hub: FrameHub) -> None:
    patient = FrameHub(PATIENCE_S, lambda: "nothing came")
    later = threading.Timer(0.05, patient.close)
    later.start()
    with pytest.raises(BusError, match="closed"):
        patient.latest(1.0)
    later.join()
    assert list(patient.frames(3)) == []


def test_two_tasks_share_a_reader() -> None:
    hub = FrameHub(PATIENCE_S, lambda: "nothing came")

    async def read() -> list[int]:
        reader = hub.frames(4)
        waiting = [asyncio.ensure_future(anext_of(reader)) for _ in range(2)]
        await asyncio.sleep(0)
        hub.put(frame(1))
        await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
        hub.put(frame(2))
        return sorted(each.cycle for each in await asyncio.gather(*waiting))

    assert asyncio.run(read()) == [1, 2]

"""A reader of 100 images a second beside a program that floods the hub with a reader's stolen keys.

Images go on to come, however slow the machine is, nothing of what is denied comes, and the hub's memory has a limit.
``pytest tests/hub/test_floods.py -s`` prints how many images come, and how late.
"""

import sys
import time
from collections.abc import Iterator
from itertools import count

import numpy as np
import pytest

from canskin.messages import IMAGE, Image
from canskin.peers import Peer
from tests import messages as make
from tests.hub.world import World

#: Of the images; their publisher sends `PIXELS` bytes.
RATE_HZ, IMAGES, PIXELS = 100, 150, 16_384
#: The hub takes less, whoever sends messages of 200 MB.
HUB_BYTES_MAX = 180_000_000
#: What a program does without end: with `session` and the number of the turn.
FLOODS = {
    "nothing": "time.sleep(0.1)",
    "denied messages of 20 kB": "session.put('canskin/palm/image', bytes(20_000))",
    "denied questions": "list(session.get('canskin/palm/calibration', payload=tare, timeout=1))",
    "denied tokens": "session.liveliness().declare_token(f'canskin/palm/alive/gateway/x{turn}--').undeclare()",
    "its own tokens": "session.liveliness().declare_token(f'canskin/palm/alive/client/x{turn}--').undeclare()",
    "tokens that it keeps": "kept.append(session.liveliness().declare_token(f'canskin/palm/alive/client/x{turn}--'))",
    "its own questions": "list(session.get('canskin/palm/description', payload=b'\\x80', timeout=1))",
    "messages of 200 MB": "session.put('canskin/palm/image', bytes(200_000_000))",
    "sessions": "open_client(sys.argv[1], 'other', None, 9, keys=keys).close()",
    "connections that say nothing": "kept = [*kept[-900:], socket.create_connection(address)]",
}
FLOOD = """
import socket, sys, time
import msgspec
from pathlib import Path
from canskin.calibration_messages import CalibrationRequest
from canskin.keys import Keys
from canskin.session import open_client
tare = msgspec.msgpack.encode(CalibrationRequest(action="tare", force=True))
keys = Keys(Path(sys.argv[2]))
address = ("127.0.0.1", int(sys.argv[1].rpartition(":")[2]))
session = open_client(sys.argv[1], "flood", None, 60, keys=keys)
turn, shown_s, kept = 0, time.monotonic(), []
while True:
    {flood}
    turn += 1
    if time.monotonic() - shown_s > 1 or turn == 1:
        print(turn, "turns", flush=True)
        shown_s = time.monotonic()
"""


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    made = World(tmp_path_factory.mktemp("floods"), has_keys=True)
    yield made
    made.close()


@pytest.mark.slow
@pytest.mark.parametrize("flood", FLOODS)
def test_the_reader_goes_on(world: World, flood: str) -> None:
    late_ns: list[int] = []
    seen: list[Peer] = []

    def take(image: Image) -> None:
        late_ns.append(time.monotonic_ns() - image.published_mono_ns)

    reader, maker = world.join("client"), world.join("reconstructor")
    reader.subscribe(IMAGE, take)
    reader.watch_peers(lambda peer, _is_there: seen.append(peer))
    keys = world.folder / "keys" / "client.stolen"
    world.processes.start("flood", sys.executable, "-c", FLOOD.format(flood=FLOODS[flood]), world.endpoint, str(keys))
    world.processes.await_words("flood", "turns")
    late_ns.clear()
    begin_s, cycles = time.monotonic(), count(1)

    def publish() -> bool:
        cycle = next(cycles)
        time.sleep(max(0.0, begin_s + cycle / RATE_HZ - time.monotonic()))
        maker.publish(IMAGE, make.image(cycle, pixels=bytes(PIXELS), published_mono_ns=time.monotonic_ns()))
        return len(late_ns) >= IMAGES

    world.processes.until(publish, f"{IMAGES} images", every_s=0.0)
    took_s = time.monotonic() - begin_s
    turns = world.processes.log("flood").read_text().splitlines()[-1]
    world.processes.stop("flood")
    reader.close()
    maker.close()
    p50_ms, p99_ms = np.percentile(late_ns, [50, 99]) / 1e6
    rate_hz = len(late_ns) / took_s
    print(f"{flood}, {turns} in {took_s:.0f} s: {rate_hz:.0f} images/s, median {p50_ms:.1f} ms, p99 {p99_ms:.0f} ms")
    assert not reader.malformed  # no message of the flood came
    assert not world.tared
    assert {each.instance for each in seen if each.service == "gateway"} <= {world.gateway.instance}
    assert world.processes.peak_bytes("hub") < HUB_BYTES_MAX

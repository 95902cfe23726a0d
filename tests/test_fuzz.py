"""Files, frames and messages with errors: a result, or a refusal that a user can read, and nothing else."""

import os
import re
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import can
import msgspec
import numpy as np
import pytest
import trimesh

from bandwidth.logs import read_log
from bus.protocol import Hello, Kind, ProtocolError, pack, unpack, unpack_frames, unpack_json
from canskin.calibration_messages import CalibrationReply, CalibrationRequest
from canskin.description import DescriptionRequest, LayoutReply, LayoutRequest
from canskin.errors import UNDECODABLE, SkinError
from canskin.messages import MEASUREMENT, CycleMeasurement, SteppedMeasurement, Topic
from classifier.modelfile import load_model, save_model
from classifier.touches import Span, add_labels, read_labels
from classifier.training import TrainingOptions, train
from dbc import indices as od
from dbc.frame import FRAME, Frames, frames
from dbc.frame_bits import frame_time_ns
from dbc.program import Program
from dbc.values import decode
from gateway.sdo import Download, Read, SdoDialogue, SdoError, Write, one
from health.state import TOPICS, ViewState
from nodes.storage import Storage
from recording.mcap_file import read_about, read_entries, read_topics
from skin.calibration_file import encoded, new_calibration, parse_calibration
from skin.chains import read_chains, read_positions
from skin.foreign import with_foreign_dbc
from skin.importing import read_icub, read_urdf
from skin.layout import parse_layout
from skin.matrix import read_matrix
from skin.measured_sums import check_measurement
from tests import messages as make
from tests.bandwidth.log_corpus import CORPUS
from tests.descriptions import DBC, URDF, icub
from tests.health.helpers import Messages
from tests.layouts import layout_toml, small_contract, small_layout
from tests.recording.helpers import write_run
from tests.world import World
from touch.meshes import MeshPose, load_mesh
from touch.reading import read_counts

#: Changed copies of each file, frame and message, for example 1000000.
EXAMPLES = int(os.environ.get("SKIN_FUZZ", "40"))
#: No copy takes longer: a file of some kilobytes.
MOST_S = 10.0
#: What is often put in place of a byte.
BYTES = b"\x00\x01\x7f\x80\xff-+.,;:#\n \"'[]{}()<>/=0123456789eExn"
EIGHT, CONTRACT = small_layout(8, 8), small_contract()
LOGS = ("log", "asc", "blf", "trc", "csv", "db", *["mf4"] * (find_spec("asammdf") is not None))


def changed(content: bytes, random: np.random.Generator) -> bytes:
    """Return a copy with up to four errors: bytes replaced, left out, repeated, put elsewhere, or cut off."""
    copy = bytearray(content)
    for _ in range(random.integers(1, 5)):
        first = int(random.integers(len(copy) + 1))
        last = min(len(copy), first + int(random.choice((1, 2, 4, 8, 64))))
        match random.integers(6):
            case 0:
                copy[first:last] = bytes(random.choice(list(BYTES), last - first).astype(np.uint8))
            case 1:
                copy[first:last] = random.bytes(last - first)
            case 2:
                del copy[first:last]
            case 3:
                copy[first:first] = copy[first:last] * int(random.choice((1, 2, 50)))
            case 4:
                place = int(random.integers(len(copy) + 1))
                copy[place:place] = copy[first:last]
            case _:
                del copy[first + (len(copy) - first) // 2 :]
    return bytes(copy)


def copies(content: bytes) -> Iterator[bytes]:
    random = np.random.default_rng(len(content))
    for _ in range(EXAMPLES):
        yield changed(content, random)


def read_frames(path: Path) -> None:
    """Read a log; each of its frames has a length on the bus."""
    for found in read_log(path, lambda _: None).values():
        assert (frame_time_ns(found, 1_000_000, 2_000_000) >= 0).all()


def written(folder: Path) -> dict[str, tuple[Path, Callable[[Path], Any]]]:
    """Return a file of each kind, and what reads it."""
    log = [can.Message(timestamp=1.0 + each, arbitration_id=0x181, data=bytes(8), channel=0) for each in range(4)]
    for suffix in LOGS:
        with can.Logger(folder / f"log.{suffix}") as logger:
            for each in log:
                logger(each)
    for name, content in CORPUS.items():
        (folder / name).write_bytes(content)
    for suffix in ("stl", "ply", "obj", "off"):
        trimesh.creation.icosphere(3, 10.0).export(folder / f"ball.{suffix}")
    np.savez(folder / "counts.npz", image=np.zeros((2, 8, 8)))
    np.save(folder / "counts.npy", np.zeros((2, 8, 8)))
    np.savetxt(folder / "phi.csv", np.ones((4, 8)), "%d", ",")
    np.savez(folder / "phi.npz", phi=np.ones((4, 8)))
    (folder / "hand.urdf").write_text(URDF.format(order="row-major"))
    (folder / "places.csv").write_text("x_m,y_m,z_m,nx,ny,nz\n" + "0.1,0.2,0.3,0,0,1\n" * 8)
    (folder / "chains.csv").write_text(
        "board,place,taxel\n" + "".join(f"{taxel // 4},{taxel % 4},{taxel}\n" for taxel in range(8))
    )
    positions, names = icub(folder, {0: "triangle_10pad"})
    write_run(folder / "run.mcap", CONTRACT)
    touches = np.random.default_rng(1).uniform(0, 0.01, (24, 8, 8)).astype(np.float32), np.array(["cup", "can"] * 12)
    save_model(train(*touches, EIGHT, options=TrainingOptions(no_touches=50)), folder / "model.npz")
    add_labels(folder / "run.mcap", [Span(0, 10**18, "cup")])
    (folder / "skin.bin").write_bytes(Program(1, 2, 3, "1.1", bytes(100)).image)
    Storage("f", folder / "node.json", 5).save({0x2001: {0: b"\1\2"}})
    (folder / "drives.dbc").write_text(DBC)
    pose = MeshPose(stems=("ball",), turns=(), unit="mm")
    read: dict[str, Callable[[Path], Any]] = {
        **dict.fromkeys((*(f"log.{each}" for each in LOGS), *CORPUS), read_frames),
        **{f"ball.{each}": partial(load_mesh, pose=pose) for each in ("stl", "ply", "obj", "off")},
        "counts.npz": partial(read_counts, arrays=None),
        "counts.npy": partial(read_counts, arrays=None),
        "phi.csv": read_matrix,
        "phi.npz": read_matrix,
        "hand.urdf": read_urdf,
        "places.csv": read_positions,
        "chains.csv": partial(read_chains, columns=8),
        positions.name: partial(read_icub, modules=names),
        "model.npz": partial(load_model, layout=EIGHT, phi=EIGHT.phi()),
        "run.labels.json": lambda path: read_labels(path.with_name("run.mcap")),
        "skin.bin": Program.read,
        "node.json": partial(Storage, "f"),
        "drives.dbc": lambda path: with_foreign_dbc({"name": "bus", "foreign_dbc": path.name}, path.parent),
        "run.mcap": lambda path: (read_about(path), read_topics(path), list(read_entries(path, lambda _: None))),
    }
    return {name: (folder / name, function) for name, function in read.items()}


KINDS = (
    *(f"log.{each}" for each in LOGS),
    *CORPUS,
    *(f"ball.{each}" for each in ("stl", "ply", "obj", "off")),
    "counts.npz", "counts.npy", "phi.csv", "phi.npz", "hand.urdf", "places.csv", "chains.csv", "arm.txt", "run.mcap",
    "model.npz", "run.labels.json", "skin.bin", "node.json", "drives.dbc",
)  # fmt: skip


#: What reads bytes that come from outside.
READS = re.compile(
    r"read_file\(|read_text\(|read_bytes\(|open\(\"rb\"\)|\.recv\w*\(|Decoder\(|\.decode\(.*type=|unpack_from\("
    r"|make_reader\(|StreamReader\(|recvmmsg|\.load_mesh\("
)
#: The kind of file, or the test, that gives damaged bytes to each product file that matches `READS`.
READERS = {
    "bandwidth/log_file.py": "log.log", "skin/matrix.py": "phi.npz", "skin/text_tables.py": "places.csv",
    "skin/importing.py": "hand.urdf", "skin/foreign.py": "drives.dbc", "touch/meshes.py": "ball.stl",
    "touch/reading.py": "counts.npz", "recording/mcap_file.py": "run.mcap", "classifier/modelfile.py": "model.npz",
    "classifier/touches.py": "run.labels.json", "dbc/program.py": "skin.bin", "nodes/storage.py": "node.json",
    "skin/layout.py": "test_a_text", "skin/limits.py": "test_a_text", "skin/calibration_file.py": "test_a_text",
    "bus/protocol.py": "test_a_text",
    "client/canskin/messages.py": "test_a_message", "client/canskin/fabric.py": "test_a_message",
    "commissioning/node_objects.py": "test_answers",
    "bus/datagrams.py": "test_frames", "bus/python_can.py": "test_frames",
}  # fmt: skip
#: Product files that match `READS`, and why there is no such target.
ELSEWHERE = {
    "their bytes go to a target unread": (
        "bus/arbitrated.py", "bus/server.py", "bus/multicast.py", "calibration/command.py",
        "reconstructor/command.py", "nodes/contract_command.py", "touch/datasets/folder.py",
    ),
    "files of this program, or of its package": (
        "classifier/cache.py", "dbc/generate.py", "deploy/configuration.py", "hub/authority.py", "hub/holders.py",
        "nodes/firmware/export.py", "nodes/firmware/flash.py", "recording/replay_folder.py", "shell/command.py",
        "shell/compiled.py", "views/ros2/names.py",
    ),
    "the kernel's": (
        "bus/interface.py", "client/canskin/skin_clock.py", "health/host_time.py", "shell/pulse.py",
        "shell/service.py",
    ),
    "what libraries alone read: msgspec, TLS": ("views/page/app.py", "client/canskin/keys.py"),
}  # fmt: skip


def test_every_reader_of_bytes_from_outside_has_a_target() -> None:
    root = Path(__file__).parents[1]
    rooms = {name.partition("/")[0] for name in (*READERS, *(each for names in ELSEWHERE.values() for each in names))}
    rooms |= {path.parent.name for path in root.glob("*/__init__.py")} - {"demo", "evaluation", "tests", "docs"}
    found = {
        str(path.relative_to(root))
        for room in rooms
        for path in (root / room).rglob("*.py")
        if READS.search(path.read_text("utf-8"))
    }
    assert found == {*READERS, *(each for names in ELSEWHERE.values() for each in names)}
    tests = {name for name in globals() if name.startswith("test_")}
    assert all(kind in KINDS or any(name.startswith(kind) for name in tests) for kind in READERS.values())


def check(read: Callable[[Any], object], content: Any, *refusals: type[Exception]) -> None:
    """Read; let only a refusal with words come."""
    begun_s, words = time.thread_time(), "read"
    try:
        read(content)
    except (SkinError, *refusals) as error:
        words = str(error)
    except Exception as error:
        raise AssertionError(repr(content)[:2000]) from error
    assert words
    assert time.thread_time() - begun_s < MOST_S, repr(content)[:2000]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, Callable[[Path], Any]]]:
    return written(tmp_path_factory.mktemp("files"))


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_with_errors_is_read_or_refused(
    files: dict[str, tuple[Path, Callable[[Path], Any]]], kind: str, tmp_path: Path
) -> None:
    whole, read = files[kind]
    read(whole)
    path = tmp_path / whole.name

    def read_copy(content: bytes) -> None:
        path.write_bytes(content)
        read(path)

    for content in copies(whole.read_bytes()):
        check(read_copy, content)


def take_packet(packet: bytes) -> None:
    header, payload = unpack(packet)
    if header.kind == Kind.HELLO:
        unpack_json(payload, Hello)
    else:
        unpack_frames(header, payload)


@pytest.mark.parametrize(
    ("content", "parse"),
    [
        (layout_toml(16, 16, bus=[{"name": "left", "nodes": 8}]).encode(), partial(parse_layout, origin="x")),
        (encoded(new_calibration(EIGHT)), partial(parse_calibration, layout=EIGHT, origin="x")),
        (pack(Kind.HELLO, msgspec.json.encode(Hello(name="a", bitrate=500_000))), take_packet),
        (pack(Kind.FRAMES, frames(2).tobytes(), count=2), take_packet),
    ],
    ids=["layout", "calibration", "hello", "packet"],
)  # fmt: skip
def test_a_text_or_packet_with_errors_is_read_or_refused(content: bytes, parse: Callable[[bytes], object]) -> None:
    for each in copies(content):
        check(parse, each, ProtocolError)


def sent() -> list[tuple[Topic, msgspec.Struct]]:
    """Return a message of each topic that a page takes."""
    make = Messages()
    found = [make.image(), make.contacts(), make.truth(), make.label(), make.gateway(), make.nodes()]
    return [(topic, each) for topic in TOPICS for each in found if type(each) is topic.message]


@pytest.mark.parametrize(("topic", "message"), sent(), ids=lambda each: getattr(each, "name", ""))
def test_a_message_with_errors_is_shown_or_left_out(topic: Topic, message: msgspec.Struct) -> None:
    state, decode = ViewState(Messages().layout), topic.decoder()

    def show(content: bytes) -> None:
        state.take(decode(content), 1.0)
        state.snapshot(1.0)

    for each in copies(msgspec.msgpack.encode(message)):
        check(show, each, *UNDECODABLE)


@pytest.mark.parametrize(
    ("decode", "message"),
    [
        *((MEASUREMENT.decoder(), each) for each in (make.measurement(),)),
        *(
            (msgspec.msgpack.Decoder(type(each)).decode, each)
            for each in (
                CalibrationRequest(action="tare", region=(1, 1, 2, 2)),
                CalibrationReply(is_done=True, text="a"),
                LayoutRequest(),
                LayoutReply("a"),
                DescriptionRequest(),
            )
        ),
    ],
    ids=lambda each: type(each).__name__,
)
def test_a_message_with_errors_between_services_is_refused(
    decode: Callable[[bytes], Any], message: msgspec.Struct
) -> None:
    phi = EIGHT.phi()

    def take(content: bytes) -> None:
        found = decode(content)
        if isinstance(found, CycleMeasurement | SteppedMeasurement):
            check_measurement(found, phi, type(found))

    for each in copies(msgspec.msgpack.encode(message)):
        check(take, each, *UNDECODABLE)


#: Answers of a device: expedited with and without a size, in segments, aborts, of downloads, of blocks.
ANSWERS = [
    bytes.fromhex(each)
    for each in (
        "4318100101020304", "4218100191010000", "4f18100105000000", "4118100109000000", "4018100100000000",
        "0001020304050607", "1001020304050607", "0d01000000000000", "1d01000000000000", "8018100100000206",
        "8000000000000405", "6018100100000000", "2000000000000000", "3000000000000000", "a4181001047f0000",
        "a2047f0000000000", "a100000000000000", "e018100100000000",
    )
]  # fmt: skip


def test_answers_with_errors_end_a_dialogue_with_a_value_or_a_reason() -> None:
    random = np.random.default_rng(2)
    kinds = [*od.BITS, od.VISIBLE_STRING, od.UNICODE_STRING, 0x0F]
    for number in range(EXAMPLES):
        kind = kinds[number % len(kinds)]
        transfer = [Read(0x1018, 1, kind), Write(0x1018, 1, b"ab"), Download(0x1018, 1, bytes(200))][number // 64 % 3]
        said = [ANSWERS[each] for each in random.integers(len(ANSWERS), size=40)]
        said = [each if random.random() < 0.6 else changed(each, random)[:8] for each in said]

        def talk(said: list[bytes]) -> None:
            dialogue, now_s = SdoDialogue(1, one(transfer), lambda *_: 1, 0.0), 0.0  # noqa: B023
            while not dialogue.done and now_s < 1000.0:
                now_s += 0.05
                dialogue.take(said[round(20 * now_s) % len(said)], now_s)
                dialogue.tick(now_s)
            assert dialogue.done
            if dialogue.error is not None:
                raise dialogue.error
            if isinstance(transfer, Read):  # noqa: B023
                decode(kind, dialogue.result)  # type: ignore[arg-type]  # noqa: B023

        check(talk, said, SdoError)


def test_frames_with_errors_do_nothing_to_the_gateway() -> None:
    """Any frames: identifiers of nodes and others, of any length and kind, SDO answers among them."""
    world, random = World(CONTRACT), np.random.default_rng(1)
    world.until_whole(3.0)

    def take(burst: Frames) -> None:
        world.gateway.take(0, burst, world.now_s, stamp_error_ns=0)

    for _ in range(EXAMPLES):
        burst = np.frombuffer(bytearray(random.bytes(FRAME.itemsize * 16)), FRAME).copy()
        burst["can_id"][:12] = random.choice((0x000, 0x080, 0x081, 0x100, 0x181, 0x381, 0x581, 0x601, 0x701, 0x7E4), 12)
        burst["flags"][:8] = 0
        burst["length"] = random.choice((0, 1, 2, 4, 8), 16)
        burst["data"][:, 0] = np.where(random.random(16) < 0.5, burst["data"][:, 0], random.integers(0, 8, 16) << 5)
        check(take, burst)
        world.step()

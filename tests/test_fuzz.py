"""Files, frames and messages with errors: a result, or a refusal that a user can read, and nothing else."""

import os
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import can
import msgspec
import numpy as np
import pytest
import trimesh

from bandwidth.logs import read_log
from canskin.errors import UNDECODABLE, SkinError
from canskin.messages import Topic
from dbc.frame import FRAME, Frames
from health.state import TOPICS, ViewState
from recording.mcap_file import read_about, read_entries, read_topics
from skin.calibration_file import encoded, new_calibration, parse_calibration
from skin.chains import read_chains, read_positions
from skin.importing import read_icub, read_urdf
from skin.layout import parse_layout
from skin.matrix import read_matrix
from tests.bandwidth.log_corpus import CORPUS
from tests.descriptions import URDF, icub
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


def written(folder: Path) -> dict[str, tuple[Path, Callable[[Path], Any]]]:
    """Return a file of each kind, and what reads it."""
    log = [can.Message(timestamp=1.0 + each, arbitration_id=0x181, data=bytes(8), channel=0) for each in range(4)]
    for suffix in ("log", "asc", "blf", "trc", "csv", "db"):
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
    pose = MeshPose(stems=("ball",), turns=(), unit="mm")
    read: dict[str, Callable[[Path], Any]] = {
        **{f"log.{each}": partial(read_log, warn=lambda _: None) for each in ("log", "asc", "blf", "trc", "csv", "db")},
        **{each: partial(read_log, warn=lambda _: None) for each in CORPUS},
        **{f"ball.{each}": partial(load_mesh, pose=pose) for each in ("stl", "ply", "obj", "off")},
        "counts.npz": partial(read_counts, arrays=None),
        "counts.npy": partial(read_counts, arrays=None),
        "phi.csv": read_matrix,
        "phi.npz": read_matrix,
        "hand.urdf": read_urdf,
        "places.csv": read_positions,
        "chains.csv": partial(read_chains, columns=8),
        positions.name: partial(read_icub, modules=names),
        "run.mcap": lambda path: (read_about(path), read_topics(path), list(read_entries(path, lambda _: None))),
    }
    return {name: (folder / name, function) for name, function in read.items()}


KINDS = (
    *(f"log.{each}" for each in ("log", "asc", "blf", "trc", "csv", "db")),
    *CORPUS,
    *(f"ball.{each}" for each in ("stl", "ply", "obj", "off")),
    "counts.npz", "counts.npy", "phi.csv", "phi.npz", "hand.urdf", "places.csv", "chains.csv", "arm.txt", "run.mcap",
)  # fmt: skip


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


@pytest.mark.parametrize(
    ("content", "parse"),
    [
        (layout_toml(16, 16, bus=[{"name": "left", "nodes": 8}]).encode(), partial(parse_layout, origin="x")),
        (encoded(new_calibration(EIGHT)), partial(parse_calibration, layout=EIGHT, origin="x")),
    ],
    ids=["layout", "calibration"],
)  # fmt: skip
def test_a_text_with_errors_is_read_or_refused(content: bytes, parse: Callable[[bytes], object]) -> None:
    for each in copies(content):
        check(parse, each)


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

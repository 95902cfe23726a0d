"""Several skins in one recording: each is read as from a file of its own."""

import threading
import time
from contextlib import closing
from pathlib import Path

import pytest

from canskin.messages import CONTACTS, LABEL
from dbc.contract import Contract
from dbc.frame import Frames
from recording import is_recording
from recording.mcap_file import (
    CALIBRATION_FILE,
    File,
    newest_file,
    parts_of,
    read_about,
    read_entries,
    read_few,
    read_topics,
    recording_id,
)
from recording.record_command import record
from recording.sinks import McapSink
from shell.service import StopSignal
from shell.skin_options import SkinOptions, join
from skin.layout import changed, load_layout
from tests import messages as make
from tests.client.helpers import await_peers
from tests.processes import PATIENCE_S, Verb
from tests.recording.helpers import OFFSET_NS, messages_of, write_messages


@pytest.fixture(scope="session")
def other(contract: Contract) -> Contract:
    return Contract.from_layout(changed(contract.layout, name="other"))


def of_both(path: Path, contract: Contract, other: Contract) -> list[McapSink]:
    first = McapSink(path, other, 1, OFFSET_NS, part="other")
    return [first, McapSink(first, contract, 1, OFFSET_NS, part="small")]


@pytest.mark.parametrize("is_whole", [True, False])
def test_a_skin_of_many_is_read_as_from_a_file_of_its_own(
    contract: Contract, other: Contract, bus_frames: dict[int, Frames], tmp_path: Path, *, is_whole: bool
) -> None:
    alone, many = tmp_path / "alone.mcap", tmp_path / "run.mcap"
    sinks = [McapSink(alone, contract, 1, OFFSET_NS), *of_both(many, contract, other)]
    sinks[1].message(LABEL, 1, b"of the other skin")
    for sink in (sinks[0], sinks[2]):
        for number, frames in bus_frames.items():
            sink.frames(number, frames, 1, OFFSET_NS)
        write_messages(sink, contract)
        sink.attach(File(CALIBRATION_FILE, "application/json", b"zero"), 9)
    for sink in sinks:
        sink.flush()
    for sink in sinks:
        sink.close() if is_whole else sink.abandon()
    part = many / "small"
    assert parts_of(many) == {"other": many / "other", "small": part}
    assert parts_of(alone) == {"small": alone}
    assert is_recording(part)
    assert [load_layout(each) for each in parts_of(many).values()] == [other.layout, contract.layout]
    for from_ns in (0, 3):
        assert [*read_entries(part, lambda _: None, from_ns)] == [*read_entries(alone, lambda _: None, from_ns)]
    assert [*read_few(part, CONTACTS)] == [*read_few(alone, CONTACTS)]
    for read in (read_about, read_topics, recording_id):
        assert read(part) == read(alone)
    assert [newest_file(each, CALIBRATION_FILE) for each in (part, many / "other")] == [b"zero", None]
    assert read_topics(many / "other") == {LABEL.name}


def test_verbs_take_the_skin_that_is_named_and_list_the_skins_without_a_name(
    contract: Contract, other: Contract, tmp_path: Path, skin: Verb
) -> None:
    many = tmp_path / "run.mcap"
    sinks = of_both(many, contract, other)
    write_messages(sinks[1], contract)
    for sink in sinks:
        sink.close()
    for verb in (["export"], ["replay", "--out", str(tmp_path / "x.npz")], ["label"], ["view", "--port", "0"]):
        code, _, told = skin(verb[0], str(many), *verb[1:])
        assert (code, told) == (
            2,
            f"skin: {many}: has the skins 'other', 'small': give --skin NAME, or {many}/other as its path\n",
        )
        code, _, told = skin(verb[0], str(many), "--skin", "arm", *verb[1:])
        assert (code, told) == (2, f"skin: {many}: has no skin 'arm', but the skins 'other', 'small'\n")
    assert skin("export", str(many), "--skin", "small")[0] == 0
    assert skin("label", str(many / "small"), "0:1=cup")[0] == 0
    assert {each.name for each in tmp_path.iterdir()} == {"run.mcap", "run-small.npz", "run-small.labels.json"}


@pytest.mark.heavy
def test_one_recorder_takes_all_skins_of_a_hub(
    contract: Contract, other: Contract, endpoint: str, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stop = StopSignal()
    monkeypatch.setattr(StopSignal, "install", lambda _self: stop)
    recording = threading.Thread(
        target=record, args=(out,), kwargs={"of": SkinOptions(connect=endpoint), "frames": False}
    )
    with (
        closing(join(contract.layout, "gateway", endpoint, hub=True)) as small,
        closing(join(other.layout, "gateway", endpoint)) as beside,
    ):
        await_peers(small, "other/gateway")
        recording.start()
        await_peers(small, "small/recorder", "other/recorder")
        for gateway, label in ((small, "cup"), (beside, "ball")):
            gateway.publish(LABEL, make.label(label=label))
        give_up_s = time.monotonic() + PATIENCE_S
        while not all(LABEL.name in read_topics(each) for each in parts_of(out).values()):
            assert time.monotonic() < give_up_s
        stop.set()
        recording.join()
    assert [[each.label for each in messages_of(out / name, LABEL)] for name in ("small", "other")] == [
        ["cup"],
        ["ball"],
    ]

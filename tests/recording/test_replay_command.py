"""``skin replay`` as a user calls it."""

from pathlib import Path

import msgspec
import pytest

from canskin.errors import InputError, RunError
from canskin.messages import MEASUREMENT
from dbc.contract import Contract
from dbc.frame import frames
from recording import replay_command
from recording.replay_command import replay
from recording.sinks import McapSink
from tests import messages as make
from tests.recording.helpers import OFFSET_NS


@pytest.mark.heavy
def test_a_replay_that_made_no_measurement_leaves_no_file(
    contract: Contract, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A model takes long to train, and nothing is classified here.
    monkeypatch.setattr(replay_command, "find_or_train", lambda *_: None)
    monkeypatch.setattr(replay_command, "Classifier", lambda *_: None)
    empty, out = tmp_path / "empty.mcap", tmp_path / "new.mcap"
    McapSink(empty, contract, 1, OFFSET_NS).close()
    with pytest.raises(InputError, match="nothing to play"):
        replay(empty, out=out)
    assert not out.exists()
    strange = tmp_path / "strange.mcap"
    sink = McapSink(strange, contract, 1, OFFSET_NS)
    strange_frames = frames(1)
    strange_frames["can_id"], strange_frames["time_ns"] = 0x7FF, 1_000_000
    sink.frames(0, strange_frames, 1_000_000 + OFFSET_NS, OFFSET_NS)
    sink.close()
    dead = tmp_path / "dead.mcap"
    sink = McapSink(dead, contract, 1, OFFSET_NS)
    blocks, sums = contract.phi.blocks, contract.phi.shape[0]
    nothing = make.measurement(sums=bytes(4 * sums), valid=bytes(blocks), fingerprint=contract.phi.fingerprint)
    sink.message(MEASUREMENT, 1, msgspec.msgpack.encode(nothing))
    sink.close()
    for path, new in ((strange, out), (dead, tmp_path / "new.npz")):
        with pytest.raises(RunError, match="gave no measurement with a valid block"):
            replay(path, out=new)
        assert not new.exists()

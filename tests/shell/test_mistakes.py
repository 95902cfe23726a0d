"""Ordinary mistakes at the verbs that need no running skin: one clear line, exit code 2, and nothing is written."""

import shlex
from pathlib import Path

import numpy as np
import pytest

from tests.descriptions import URDF
from tests.processes import Verb

#: What was typed, in a folder of `files`, and what the answer says.
MISTAKES = (
    ("layout new", "expected the taxels: 24x32, or a file"),
    ("layout new 24x", "24x: no such file, and no layout of canskin"),
    ("layout new 0x0", "expected 1 or more, got 0"),
    ("layout new 1x1", "expected 8 taxels or more, got 1"),
    ("layout new 1000x1000", "expected 256 or less, got 1000"),
    ("layout new none.csv", "none.csv: cannot read the positions: No such file"),
    ("layout new folder.toml", "Is a directory"),
    ("layout new text.mcap", "text.mcap: is no MCAP file"),
    ("layout new hand.urdf --out hand.csv", "expected a file for the layout that ends in .toml, got '.csv'"),
    ("layout new hand.urdf --out none/x.toml", "the folder for the layout does not exist"),
    ("layout new strip.csv --ini text.mcap", "leave out --ini"),
    ("layout new strip.csv --sending often", 'Choose from: "synchronous", "steps"'),
    ("layout check strip.csv", "is a file of taxels: make a layout of it with 'skin layout new strip.csv"),
    ("layout check stamps.npz", "expected TOML"),
    ("layout check folder.mcap", "folder.mcap: cannot be read"),
    ("layout check pad --out x.toml", "--out is for 'skin layout new'"),
    ("layout draw pad --out pad.gif", "picture that ends in .png, .svg, .pdf, got '.gif'"),
    ("layout setings pad", 'Did you mean "settings"?'),
    ("plan --taxels 0", "expected 64 to 65536 taxels, got 0"),
    ("plan --taxels 24x32 --rate nan", "expected a rate above 0 and up to 2000 Hz, got nan"),
    ("plan --taxels 24x32 --buses 0", "expected 1 to 16 buses, got 0"),
    ("plan --taxels 24x32 --budget 80", "expected a budget above 0 and up to 1"),
    ("plan --taxels none.csv", "expected a number, ROWSxCOLUMNS, or a file of taxels: none.csv"),
    ("plan --taxels 24x32 --can canfd", 'Choose from: "any", "classic", "fd"'),
    ("plan --taxels 24x32 --out x.json", "that ends in .toml, got '.json'"),
    ("plan --taxels 24x32 --jitter-s nan", "--jitter-s needs a number from 0 to 1: got nan"),
    ("plan pad --rate 50", "a search with --taxels takes no layout"),
    ("plan pad --sdo-per-s -5", "--sdo-per-s needs a number from 0"),
    ("plan pad --timing --clock-hz 0", "--clock-hz needs a number above 0"),
    ("plan strip.csv", "make a layout of it with 'skin layout new strip.csv"),
    ("contract pad --out text.mcap", "text.mcap: cannot write the files"),
    ("contract pad --check --out none", "none: cannot read the contract files"),
    ("contract pad --firmware --node bus9:1 --out fw", "expected BUS:NODE or BUS:FIRST-LAST with BUS of bus0"),
    ("contract pad --program none --release 1.1 --out x.bin", "none: cannot read the program"),
    ("contract pad --program text.mcap --release 123456789 --out x.bin", "--release: expected 1 to 8 printable"),
    ("export", "expected recording; 'skin export --help' explains"),
    ("export none.mcap", "none.mcap: expected a recording of 'skin record'"),
    ("export stamps.npz", "stamps.npz: expected a recording of 'skin record'"),
    ("export text.mcap", "text.mcap: is no MCAP file"),
    ("export text.mcap --to csv", "Choose from:"),
    ("touch objects --meshes none", "expected a folder of meshes, got 'none'"),
    ("touch dataset acquisition --out text.mcap", "give another --out"),
    ("touch dataset acquisition --objects unicorn --out x", "unknown object 'unicorn': expected one of"),
    ("touch dataset acquisition --steps 0 --out x", "expected 1 to 4200 steps at speed 1, got 0"),
    ("touch dataset acquisition --defect dead=5 --out x", "ratio needs a number from 0 to 1: got 5"),
    ("touch dataset classification --arrays 7 --out x", "unknown array side 7"),
    ("train --layout none.toml", "none.toml: cannot read the layout"),
    ("train --layout pad --objects ring", "expected 2 or more objects"),
    ("train --layout pad --touches -4", "expected --touches of 1 or more and --seed of 0 or more, got -4"),
    ("train --layout pad --out model.txt", "expected a file for the model that ends in .npz, got '.txt'"),
    ("train --layout pad --choose 4", "--choose and --layout-out belong together"),
    ("train --layout pad --noise-n nan", "expected noise above 0 and below"),
    ("train --recordings text.mcap", "--recordings: expected --out FILE"),
    ("train --recordings text.mcap --out m.npz", "text.mcap: is no MCAP file"),
    ("replay", "expected source; 'skin replay --help' explains"),
    ("replay none.mcap", "no file 'none.mcap'"),
    ("replay text.mcap --out x.txt", "expected a name that ends in .mcap, or in .npz"),
    ("replay text.mcap --speed 0", "--speed: expected a number above 0"),
    ("replay hand.urdf --layout pad --out x.mcap", "cannot be read as a log of CAN frames"),
    ("evaluate paper nothing", 'Invalid value "nothing" for PARTS'),
    ("evaluate paper sparsity --draws 0", "draws needs a whole number of 1 or more: got 0"),
    ("evaluate single-wire none", "no folder 'none'"),
    ("layout new 24x32 --out ''", "--out: expected a value, got an empty text"),
    ("train --layout pad --touches 0", "expected --touches of 1 or more"),
    ("train --layout pad --choose 0 --layout-out x.toml", "rows to keep, got 0"),
    ("train --layout pad --seed 1.5", "--seed: expected a whole number, got '1.5'"),
    ("train --layout pad --touches 99999999999", "the memory of this machine is too small"),
    ("train --layout pad --choose 4 --layout-out folder.toml", "folder.toml: is there already"),
    ("calibration gain strip.csv --out text.mcap", "expected a file for the calibration that ends in .json"),
    ("contract pad --firmware --out .", "has a README.md that 'skin contract' did not write"),
    ("record x.wav", "expected a file that ends in .mcap, or, for frames alone"),
    ("view none.mcap", "no file 'none.mcap'"),
    ("bus a --fault loss_ratio=0.1 can_id=5", "fault 'can_id=5': does nothing"),
    ("scan -i virtual -c a --bitrate 5", "expected a bit rate of 10000 to 1000000 bit/s, got 5"),
    ("gateway --layout pad --keep-zero none/zero.json", "the folder for the zero does not exist"),
    ("node objects zzz --layout pad", "no object has zzz in its name"),
    ("node get 1018h,zzz --layout pad --node 1", "by name or index:sub, got 'zzz'"),
    ("node check --layout pad --live 3 --out text.mcap", "expected a file for the wiring that ends in .csv"),
    ("node check --layout pad --live 3 --path strip.csv", "expected the header time_s,x_m,y_m,z_m"),
    ("node check --layout pad --live 3 --rest -2", "--rest needs a number of 0 or more"),
    ("nodes --layout pad --defect dead dead=0.2", "expected each kind once"),
    ("nodes --layout pad --defect drift=5", "deviation_n_per_s needs a number from 0 to 0.02: got 5"),
    ("nodes --layout analogue --defect sum-offset=9", "deviation_n needs a number from 0 to 0.64: got 9"),
    ("nodes --layout pad --input stamps.npz --objects ring", "--objects and --stroke are for the simulator"),
    ("nodes --layout pad --input stamps.npz", "'timestamp' of shape (20,): expected (time, rows, columns)"),
)  # fmt: skip


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("files")
    for name in ("text.mcap", "README.md"):
        (folder / name).write_text("no recording")
    (folder / "hand.urdf").write_text(URDF.format(order="row-major"))
    (folder / "strip.csv").write_text("x_m,y_m,z_m\n" + "".join(f"{0.004 * each},0,0\n" for each in range(12)))
    np.savez(folder / "stamps.npz", timestamp=np.arange(20))
    for name in ("folder.toml", "folder.mcap"):
        (folder / name).mkdir()
    return folder


@pytest.mark.parametrize(("typed", "says"), MISTAKES, ids=[typed for typed, _ in MISTAKES])
def test_a_mistake_has_one_clear_line(
    skin: Verb, files: Path, monkeypatch: pytest.MonkeyPatch, typed: str, says: str
) -> None:
    monkeypatch.chdir(files)
    before = sorted(files.iterdir())
    status, _, said = skin(*shlex.split(typed))
    assert (status, said.count("\n")) == (2, 1)
    assert says in said
    assert sorted(files.iterdir()) == before

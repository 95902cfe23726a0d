"""`skin node check --wiring`: what is not wired as the layout says, from a finger that goes over the skin."""

import json
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

from canskin.errors import InputError
from canskin.messages import MEASUREMENT, CycleMeasurement
from gateway.wiring import Finding, Place, prove
from gateway.wiring_check import chains_file, corrected_order
from nodes.sampler import new_sampler
from shell.command import main
from skin.chains import read_chains
from skin.defects import Defects
from skin.layout import Layout
from skin.mcap_file import RecordingWriter
from skin.measurement import of_rows
from skin.sources import Frame
from skin.sync_counter import next_counter
from tests.gateway.wiring_errors import KINDS, REST, found_of, layout_of, measured, stroke, wired
from tests.layouts import layout_toml, small_layout

MAT = layout_of("mat")


@pytest.mark.parametrize("raw", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_a_wiring_error_is_found(kind: str, raw: bool) -> None:
    for seed in range(3):
        wrong, found = found_of(MAT, kind, seed, raw=raw)
        assert found == wrong


def test_a_person_strokes_the_skin() -> None:
    wrong, found = found_of(MAT, "swapped", 1, raw=False, knows_path=False)
    assert found == wrong


def test_exchanged_patches_need_a_path() -> None:
    with pytest.raises(InputError, match="cannot tell"):
        found_of(MAT, "moved", 1, raw=False, knows_path=False)


def test_places_with_the_same_signs_are_not_told_apart() -> None:
    """The rows have 16 columns of signs for 32 places."""
    layout = small_layout(sampling={"rate_hz": 1000}, sync={"rate_hz": 5})
    phi = of_rows(layout.phi(), [(block, row) for block in range(2) for row in (1, 2, 4, 8)])
    random = np.random.default_rng(2)
    path_m, force_n = stroke(layout, phi, random, 8)
    order = phi.taxels_of_blocks.copy()
    order[0, 3], order[1, 4] = order[1, 4], order[0, 3]
    sums = measured(layout, phi, order, force_n, random, raw=False)
    findings = prove(phi, layout.taxels.surface, sums, path_m, REST)
    assert {each.kind for each in findings} == {"unclear"}
    assert {each.taxel for each in findings} == {int(order[0, 3]), int(order[1, 4])}
    with pytest.raises(InputError, match="no exchange of places"):
        corrected_order(phi, findings)


@pytest.mark.parametrize(("rest", "moments", "said"), [(0, 900, "without touch"), (20, 100, "expected 400 moments")])
def test_a_stroke_that_tells_too_little(rest: int, moments: int, said: str) -> None:
    phi, sums = MAT.phi(), np.zeros((moments, MAT.phi().shape[0]))
    with pytest.raises(InputError, match=said):
        prove(phi, MAT.taxels.surface, sums, np.zeros((moments, 3)), rest)


@pytest.mark.parametrize("kind", ["swapped", "moved"])
def test_the_corrected_file_is_what_is_wired(kind: str, tmp_path: Path) -> None:
    phi = MAT.phi()
    order, wrong = wired(phi, kind, np.random.default_rng(5))
    findings = []
    for each in sorted(wrong, key=str):
        taxel, found = each[1], each[2]
        assert isinstance(taxel, int)
        assert isinstance(found, tuple)
        expected = (
            divmod(int(phi.place_of_taxel[taxel]), phi.block_size)
            if kind == "swapped"
            else next((other[2][0], 0) for other in wrong if other != each and isinstance(other[2], tuple))
        )
        findings.append(Finding("swapped" if kind == "swapped" else "moved", taxel, Place(*expected), (Place(*found),)))
    path = tmp_path / "boards.csv"
    path.write_text(chains_file(phi, corrected_order(phi, findings)), encoding="utf-8")
    held = [[taxel for taxel in board if taxel < phi.taxels] for board in order.tolist()]
    assert [[taxel for taxel in board if taxel >= 0] for board in read_chains(path, 10)] == held


class Finger:
    has_noise = False
    step = 0

    def __init__(self, layout: Layout) -> None:
        self.path_m, self._force_n = stroke(layout, layout.phi(), np.random.default_rng(0), 6)
        self._shape = layout.taxels.rows, layout.taxels.columns

    def frame(self, step: int) -> Frame:
        self.step = min(max(step, 0), len(self._force_n) - 1)
        return Frame(self._force_n[self.step].reshape(self._shape), "")


@pytest.mark.parametrize("wrong", ["swapped", "doubled", None])
def test_the_simulated_skin_with_wiring_errors(
    wrong: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    toml = layout_toml(8, 16)
    (tmp_path / "palm.toml").write_text(toml, encoding="utf-8")
    layout = small_layout(8, 16)
    phi, finger = layout.phi(), Finger(layout)
    defects = Defects.of({wrong: 0.01} if wrong else {}, seed=3)
    sampler, counter = new_sampler(layout, phi, finger, defects=defects, noise_n=2e-4), 0
    writer = RecordingWriter(tmp_path / "stroke.mcap", {}, [], 0)
    lines = ["time_s,x_m,y_m,z_m"]
    for moment in range(len(finger.path_m)):
        counter = next_counter(counter)
        time_ns = moment * 10_000_000
        sums = sampler.sample(counter, time_ns)
        x_m, y_m, z_m = finger.path_m[finger.step]
        lines.append(f"{moment / 100},{x_m},{y_m},{z_m}")
        message = CycleMeasurement(
            cycle=moment + 1,
            sync_counter=counter,
            sampled_mono_ns=time_ns,
            sums=sums.astype("<i4").tobytes(),
            valid=phi.has_sums.tobytes(),
            fingerprint=phi.fingerprint,
        )
        writer.message(MEASUREMENT, time_ns, msgspec.msgpack.encode(message))
    writer.close()
    (tmp_path / "finger.csv").write_text("\n".join(lines), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    command = ["node", "check", "--layout", "palm.toml", "--wiring", "stroke.mcap", "--path", "finger.csv"]
    command += ["--rest", "0.15", "--json"]
    if wrong != "doubled":
        command += ["--out", "boards.csv"]
    monkeypatch.setattr(sys, "argv", ["skin", *command])
    with pytest.raises(SystemExit) as ended:
        main()
    findings = json.loads(capsys.readouterr().out)
    kinds = {"swapped": ["swapped", "swapped"], "doubled": ["dead", "doubled"], None: []}[wrong]
    assert sorted(each["kind"] for each in findings) == kinds
    assert ended.value.code == int(bool(kinds))
    if wrong != "doubled":
        named = {taxel for board in read_chains(Path("boards.csv"), 16) for taxel in board}
        assert named == set(range(128))

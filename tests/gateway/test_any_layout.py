"""Any layout: one clear error, or a skin whose plan, files, boards, gateway and solver work."""

import re
from typing import Any

import numpy as np
import pytest
import tomli_w
from hypothesis import event, given, settings
from hypothesis import strategies as st

from bandwidth.plan import plan
from canskin.errors import LayoutError
from dbc.contract import Contract
from dbc.database import database
from reconstructor.imaging import CycleImager
from skin.layout import Layout, layout_text, parse_layout
from skin.measured_sums import decode_measurement
from tests.world import World

PITCH_M = 0.005


@st.composite
def grids(draw: st.DrawFn) -> dict[str, Any]:
    rows, columns = draw(st.integers(1, 14)), draw(st.integers(1, 14))
    if draw(st.booleans()):
        return {"rows": rows, "columns": columns}
    lines = st.text("##.", min_size=columns, max_size=columns)
    return {"shape": draw(st.lists(lines, min_size=rows, max_size=rows))}


@st.composite
def places(draw: st.DrawFn) -> dict[str, Any]:
    """Draw a bent patch, whose taxels are moved at random, and some of which are missing."""
    rows, columns = draw(st.integers(2, 9)), draw(st.integers(2, 9))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    row, column = np.divmod(np.arange(rows * columns), columns)
    angle = PITCH_M * (column + random.uniform(-0.1, 0.1, row.size)) / draw(st.sampled_from((0.02, 0.05, 1.0)))
    radius = PITCH_M * columns / max(angle.max(), 1e-9)
    height = PITCH_M * (row + random.uniform(-0.1, 0.1, row.size))
    bent = np.stack((radius * np.sin(angle), height, radius * (np.cos(angle) - 1)), axis=1)
    kept = random.random(row.size) >= draw(st.sampled_from((0.0, 0.05)))
    return {"positions": bent[kept].tolist()}


@st.composite
def documents(draw: st.DrawFn) -> dict[str, Any]:
    """Draw a layout file; not each is right."""
    taxels = draw(st.one_of(grids(), places()))
    count = len(taxels.get("positions", ())) or taxels.get("rows", 0) * taxels.get("columns", 0)
    measurement: dict[str, Any] = {"block_size": draw(st.sampled_from((2, 8, 16, 32, 64)))}
    wiring = draw(st.sampled_from(("scattered", "board", "file")))
    if wiring == "file":
        order = draw(st.permutations(range(count)))
        ends = sorted(draw(st.sets(st.integers(1, max(count - 1, 1)), max_size=6)))
        measurement["chains"] = [each.tolist() for each in np.split(np.array(order, int), ends) if each.size]
        measurement["block_size"] = max(8, 1 << max(map(len, measurement["chains"] or [[]])).bit_length())
    measurement["wiring"] = wiring
    if draw(st.sampled_from((False, False, True))):
        measurement["sums"] = draw(st.integers(1, 2 * count + 1))
    sync = {"rate_hz": 20.0, "turns": draw(st.sampled_from((1, 2)))}
    return {"taxels": taxels | {"adc_bits": 8}, "measurement": measurement, "sync": sync}


def read(document: dict[str, Any]) -> Layout | LayoutError:
    try:
        return parse_layout(tomli_w.dumps(document).encode(), "any.toml")
    except LayoutError as error:
        return error


@pytest.mark.slow
@given(documents())
@settings(max_examples=40)
def test_a_layout_is_refused_or_runs(document: dict[str, Any]) -> None:
    layout = read(document)
    if isinstance(layout, LayoutError):
        event("refused")
        assert re.fullmatch(r"any\.toml: .* - at `\$\.[a-z_.0-9\[\]]+`", str(layout))
        return
    event("runs")
    assert parse_layout(layout_text(layout).encode(), "again.toml") == layout
    contract = Contract.from_layout(layout)
    phi = contract.phi
    assert [bus.name for bus in plan(contract)] == [bus.name for bus in layout.bus]
    assert all("SG_" in database(contract, bus) for bus in range(len(layout.bus)))
    random = np.random.default_rng(0)
    x, y = random.normal(size=phi.shape[1]), random.normal(size=phi.shape[0])
    assert y @ phi.forward(x) == pytest.approx(phi.adjoint(y) @ x, abs=1e-9)
    gram = phi.wired.forward(phi.wired.adjoint(np.eye(phi.shape[0])))
    assert np.array_equal(gram, phi.block_size * np.eye(phi.shape[0]))

    world = World(contract)
    world.until_whole(30.0)
    measurement = world.run(0.5)[-1]
    assert not world.wrong_blocks(measurement)
    image_n, used = CycleImager(layout).solve(decode_measurement(measurement, phi))
    assert used.all()
    assert image_n.shape == (layout.taxels.rows, layout.taxels.columns)
    assert np.isfinite(image_n).all()
    assert not image_n.ravel()[~phi.is_wired].any()
    left_n = phi.forward(image_n.ravel()) - layout.taxels.newton_per_count * np.frombuffer(measurement.sums, "<i4")
    assert np.sqrt(np.mean(left_n**2)) < 0.2 * layout.taxels.force_max_n * phi.block_size**0.5

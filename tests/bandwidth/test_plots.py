"""What the pictures of a plan show."""

from pathlib import Path

import numpy as np
import pytest

from bandwidth.plots import cycle_figure, rates_figure, write_plots
from bandwidth.scheme_rates import schemes
from bandwidth.traffic import traffic
from canskin.errors import InputError
from dbc.contract import Contract
from skin.layout import load_layout


@pytest.fixture(scope="module")
def contract() -> Contract:
    return Contract.from_layout(load_layout())


def test_rates_of_every_wire_are_drawn_against_the_number_of_buses(contract: Contract) -> None:
    figure = rates_figure(contract.layout)
    titles = [panel.get_title() for panel in figure.axes]
    assert titles == sorted(titles, key=lambda title: -int(title.split("-")[0]))
    all_schemes = [each for each in schemes(contract.layout) if each.what == "sums" and each.fits_node_ids]
    for panel in figure.axes:
        bits = int(panel.get_title().split("-")[0])
        mine = [each for each in all_schemes if each.bits == bits]
        lines = {str(line.get_label()): line for line in panel.get_lines()}
        assert set(lines) == {"classic CAN", "FD 2 Mbit/s", "FD 5 Mbit/s", "FD 8 Mbit/s", "100 Hz"}
        for name, rate in (("classic CAN", None), ("FD 2 Mbit/s", 2_000_000), ("FD 8 Mbit/s", 8_000_000)):
            buses, rates_hz = np.array(lines[name].get_data())
            assert buses.tolist() == sorted({each.buses for each in mine})
            for number, rate_hz in zip(buses, rates_hz, strict=True):
                best = max(each.max_rate_hz_worst for each in mine if (each.buses, each.data_bitrate) == (number, rate))
                assert rate_hz == best
        assert set(lines["100 Hz"].get_ydata()) == {100}
        assert panel.get_yscale() == "log"


def test_a_cycle_shows_frames_one_after_another_and_the_window(contract: Contract) -> None:
    (panel,) = cycle_figure(contract).axes
    assert [label.get_text() for label in panel.get_yticklabels()] == [bus.name for bus in contract.layout.bus]
    for number, drawn in enumerate(panel.collections):
        boxes = [path.get_extents() for path in drawn.get_paths()]
        streams = traffic(contract, number)
        took_ms = streams.worst_ns[streams.is_cyclic] / 1e6
        np.testing.assert_allclose([box.width for box in boxes], took_ms, atol=1e-9)
        assert boxes[0].x0 == 0
        np.testing.assert_allclose([box.x0 for box in boxes[1:]], [box.x1 for box in boxes[:-1]], atol=1e-9)
        assert {(round(box.y0 - number, 6), round(box.y1 - number, 6)) for box in boxes} == {(-0.35, 0.35)}
        colours = np.array(drawn.get_facecolor())
        node = streams.node[streams.is_cyclic]
        # SYNC is dark; nodes go from blue to green, each in a colour of its own.
        assert (colours[node == 0] == colours[0]).all()
        assert colours[0, :3].tolist() == [0.2, 0.2, 0.2]
        of_nodes = colours[node > 0]
        assert len(np.unique(of_nodes, axis=0)) == len(np.unique(node[node > 0]))
        assert of_nodes[0, 2] > of_nodes[0, 1]
        assert of_nodes[-1, 1] > of_nodes[-1, 2]
        assert ((colours >= 0) & (colours <= 1)).all()
    lines = {str(line.get_label()): line.get_xdata()[0] for line in panel.get_lines()}
    # 1007h is 99 % of the period.
    assert lines == {"next SYNC": 10.0, "window (1007h)": pytest.approx(9.9)}
    assert panel.get_xlim()[0] == 0
    assert panel.yaxis_inverted()


def test_pictures_that_cannot_be_written_are_one_clear_error(contract: Contract, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file: cannot write the plots: File exists"):
        write_plots(contract, tmp_path / "file")

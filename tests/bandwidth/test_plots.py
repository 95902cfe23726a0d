"""What the picture of a plan shows."""

from pathlib import Path

import numpy as np
import pytest

from bandwidth.plots import cycle_figure, write_plot
from bandwidth.traffic import traffic
from canskin.errors import InputError
from dbc.contract import Contract
from skin.layout import load_layout


@pytest.fixture(scope="module")
def contract() -> Contract:
    return Contract.from_layout(load_layout())


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
    assert lines == {"next SYNC": 5.0, "window (1007h)": pytest.approx(4.95)}
    assert panel.get_xlim()[0] == 0
    assert panel.yaxis_inverted()


def test_a_picture_that_cannot_be_written_is_one_clear_error(contract: Contract, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file: cannot write the plot: File exists"):
        write_plot(contract, tmp_path / "file")

"""What a message of the fabric becomes on ROS 2."""

import pytest

from ros2.topics import FORCE_IMAGE, HEAT_MAP, TAXEL_CLOUD, Translator
from skin.taxel_places import Grid
from skin.wall_times import WallTimes
from tests.viewer.conftest import Messages
from viewer.state import ViewState


def test_an_image_without_readers_is_not_computed(messages: Messages, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    measured_n = Grid.measured_n
    monkeypatch.setattr(Grid, "measured_n", lambda *args: made.append(1) or measured_n(*args))
    translator = Translator(messages.layout, "palm", ViewState(messages.layout), wall=WallTimes(10**18))
    drafts = dict(translator.take(messages.image(1), 0.0))
    assert list(drafts) == [FORCE_IMAGE, HEAT_MAP, TAXEL_CLOUD]
    assert made == []
    drafts[FORCE_IMAGE]()
    drafts[HEAT_MAP]()
    assert made == [1]

"""What several tests of the viewer share."""

from viewer.state import ViewState


def texts(state: ViewState, now_s: float, level: str = "error") -> list[str]:
    return [notice.text for notice in state.snapshot(now_s)[0].notices if notice.level == level]

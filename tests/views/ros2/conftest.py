"""The messages of the small skin of the viewer's tests, and a hub that is the router of the ROS network, too."""

from tests.views.page.conftest import hub, messages

__all__ = ["hub", "messages"]

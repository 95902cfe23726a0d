"""``skin ros2``: a running skin on ROS 2's wire, without ROS."""

from contextlib import closing
from typing import Annotated, Final, Literal

from cyclopts import Parameter

from shell.pulse import Pulse
from shell.service import StopSignal, say
from shell.skin_options import SkinOptions
from skin.layout import require_boards
from views.ros2.bridge import TARE, Bridge
from views.ros2.names import check_domain, check_namespace
from views.ros2.node import SERVICE, RosNode
from views.ros2.topics import topics_of
from views.ros2.types import store

#: Of ROS on this machine, as `rmw_zenohd` listens.
ROUTER: Final = "tcp/127.0.0.1:7447"


def ros2(
    *,
    of: SkinOptions | None = None,
    router: str = ROUTER,
    domain: int | None = None,
    namespace: Annotated[str | None, Parameter(name=("--namespace", "--ns"))] = None,
    frame: str | None = None,
    distro: Literal["humble", "jazzy"] = "jazzy",
) -> None:
    """Publish a running skin on ROS 2, in the form of rmw_zenoh; neither ROS nor a bridge is needed here.

    Topics: ``image`` (32FC1, newtons), ``heat_map`` (rgb8), ``points``, ``contacts``, ``contact_markers``, ``label``,
    ``wrench``, ``key`` (cycles of images and labels) and ``/diagnostics``; service: ``tare``.

    Parameters
    ----------
    of
        Which skin.
    router
        Endpoint of the ROS network's zenoh router. The hub of the fabric is a zenoh router, too: nodes of ROS may use
        the hub.
    domain
        Domain of ROS; default: ``ROS_DOMAIN_ID``, else 0.
    namespace
        Namespace of the topics; default: the name of the skin.
    frame
        Frame of the messages; default: the name of the skin. Its origin is the middle of the skin, x runs along the
        columns, y down the rows, z into the skin.
    distro
        ``humble`` for nodes of ROS 2 Humble, whose keys have no type hashes; ``jazzy`` for all newer distributions.

    Examples
    --------
    skin ros2
    skin ros2 --router tcp/robot:7447 --domain 42 --namespace /arm/palm
    """
    store()
    number, of = check_domain(domain), of or SkinOptions()
    if namespace is not None:
        check_namespace(namespace)
    stop = StopSignal().install()
    pulse = Pulse(stop)
    skin = of.find(SERVICE, stop)
    require_boards(skin)
    space = check_namespace(skin.name if namespace is None else namespace)
    with closing(of.join(skin, SERVICE, pulse)) as fabric:
        pulse.fabric = fabric
        node = RosNode(router, domain=number, namespace=space, name="canskin", stop=stop, has_hashes=distro != "humble")
        with closing(node):
            bridge = Bridge(skin, fabric, node, frame or skin.name)
            names = ", ".join(node.node.full_name(topic.name) for topic in topics_of(skin))
            say(SERVICE, f"domain {number}: {names}; service {node.node.full_name(TARE)}")
            bridge.run(stop, pulse.beat)

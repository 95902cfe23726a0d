"""Who may do what on the fabric: the one table, from which the rules of the hub are made.

With keys each program has a certificate, whose common name tells its role. A program checks its own actions, for a
clear message; the hub enforces the table, whoever the program is.
"""

from typing import Final, Literal, NamedTuple

from canskin.calibration_messages import CALIBRATION, ZERO
from canskin.description import DESCRIPTION, LAYOUT
from canskin.messages import CONTACTS, GATEWAY, IMAGE, LABEL, MARK, MEASUREMENT, NODES, SERVICES, TRUTH, Topic
from canskin.question import Question
from canskin.skin_clock import TIME

#: Publish a topic, hear a topic, ask a question, answer a question, be seen under the name of a service.
Action = Literal["put", "subscribe", "ask", "answer", "appear"]
ACTIONS: Final[tuple[Action, ...]] = ("put", "subscribe", "ask", "answer", "appear")
TOPICS: Final = (MEASUREMENT, IMAGE, CONTACTS, LABEL, TRUTH, MARK, GATEWAY, NODES, SERVICES)
QUESTIONS: Final = (LAYOUT, DESCRIPTION, TIME, CALIBRATION, ZERO)
#: What a program needs that shows touches.
_OUTPUTS: Final = (MEASUREMENT, IMAGE, CONTACTS, LABEL, GATEWAY)


class Role(NamedTuple):
    """What the holders of a role may do.

    Attributes
    ----------
    why : str
        What the role is for, and what needs its actions.
    put, subscribe : tuple of Topic
        What they may publish and hear.
    ask, answer : tuple of Question
    appear : tuple of str
        Names of services under which they may be seen.
    """

    why: str
    appear: tuple[str, ...]
    put: tuple[Topic, ...] = ()
    subscribe: tuple[Topic, ...] = ()
    ask: tuple[Question, ...] = ()
    answer: tuple[Question, ...] = ()

    def names(self, action: Action) -> tuple[str, ...]:
        """Return the names of the topics, questions or services of an action."""
        allowed: tuple[str | Topic | Question, ...] = getattr(self, action)
        return tuple(each if isinstance(each, str) else each.name for each in allowed)


#: Every role. A service hears its own messages, too: `skin-alive` with its keys looks for them. A service puts
#: SERVICES, to tell how it is.
ROLES: Final = {
    "gateway": Role(
        "skin gateway: gives the sums of the boards, and has the zero of its skin",
        ("gateway",),
        put=(MEASUREMENT, GATEWAY, SERVICES),
        subscribe=(MEASUREMENT, CONTACTS, LABEL, SERVICES),
        answer=QUESTIONS,
    ),
    "nodes": Role(
        "skin nodes: virtual boards, which tell the true forces",
        ("nodes",),
        put=(TRUTH, NODES, SERVICES),
        subscribe=(MEASUREMENT,),
    ),
    "reconstructor": Role(
        "skin reconstruct: makes images and contacts of the sums",
        ("reconstructor",),
        put=(IMAGE, CONTACTS, SERVICES),
        subscribe=(MEASUREMENT, IMAGE, CONTACTS),
        ask=(LAYOUT, TIME),
    ),
    "classifier": Role(
        "skin classify: names what touches the skin",
        ("classifier",),
        put=(LABEL, SERVICES),
        subscribe=(MEASUREMENT, LABEL),
        ask=(LAYOUT,),
    ),
    "run": Role(
        "skin run: gateway and reconstructor in one process",
        ("gateway", "reconstructor"),
        put=(MEASUREMENT, GATEWAY, IMAGE, CONTACTS, SERVICES),
        subscribe=(MEASUREMENT, IMAGE, CONTACTS, LABEL, SERVICES),
        ask=(LAYOUT, TIME),
        answer=QUESTIONS,
    ),
    "viewer": Role(
        "skin view, monitor, show, metrics, list and calibration show: changes nothing",
        ("viewer", "monitor", "show", "exporter", "calibration"),
        put=(SERVICES,),
        subscribe=TOPICS,
        ask=(LAYOUT, ZERO),
    ),
    "recorder": Role(
        "skin record: writes all messages and the zero into a file",
        ("recorder",),
        put=(SERVICES,),
        subscribe=TOPICS,
        ask=(LAYOUT, TIME, ZERO),
    ),
    "client": Role(
        "canskin.connect(): a program that reads frames",
        ("client",),
        subscribe=_OUTPUTS,
        ask=(DESCRIPTION, TIME),
    ),
    "ros2": Role(
        "skin ros2: gives ROS 2 the touches, and has a service there that measures the zero",
        ("ros2",),
        put=(SERVICES,),
        subscribe=_OUTPUTS,
        ask=(LAYOUT, CALIBRATION),
    ),
    "operator": Role(
        "a person: skin tare and calibration, a page with its actions, programs that tare or mark; and all that reads",
        ("viewer", "monitor", "show", "exporter", "calibration", "recorder", "client", "ros2"),
        put=(MARK, SERVICES),
        subscribe=TOPICS,
        ask=QUESTIONS,
    ),
}


def roles_for(action: Action, name: str) -> list[str]:
    """Return the roles that may do an action with a topic, question or service."""
    return [role for role, each in ROLES.items() if name in each.names(action)]


def refusal(role: str, action: Action, name: str) -> str:
    """Return why a role may not do an action, and which roles may; empty if it may."""
    if role in ROLES and name in ROLES[role].names(action):
        return ""
    allowed = ", ".join(f"'{each}'" for each in roles_for(action, name)) or "no role"
    return (
        f"role '{role}' may not {action}{' as' * (action == 'appear')} '{name}', {allowed} may: see 'skin keys explain'"
    )

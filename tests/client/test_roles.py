"""The table of roles: no cell is needless, and a refusal names the roles that may."""

from canskin.messages import MARK, SERVICES
from canskin.peers import MAKERS
from canskin.roles import ACTIONS, QUESTIONS, ROLES, TOPICS, refusal, roles_for


def test_every_topic_and_question_has_who_gives_and_who_takes() -> None:
    for topic in TOPICS:
        assert roles_for("put", topic.name)
        assert roles_for("subscribe", topic.name)
    for question in QUESTIONS:
        assert roles_for("answer", question.name) == ["gateway", "run"]
        assert roles_for("ask", question.name)


def test_a_person_may_all_that_programs_of_persons_may() -> None:
    for role in ("viewer", "recorder", "client", "ros2"):
        for action in ACTIONS:
            assert set(ROLES[role].names(action)) <= set(ROLES["operator"].names(action))


def test_only_who_makes_something_passes_for_a_service_that_others_need() -> None:
    for name, role in ROLES.items():
        makes = set(role.put) - {SERVICES, MARK}
        assert bool(set(role.appear) & set(MAKERS)) is bool(makes), name


def test_a_refusal_names_the_own_role_and_those_that_may() -> None:
    assert refusal("client", "ask", "calibration") == (
        "role 'client' may not ask 'calibration', 'ros2', 'operator' may: see 'skin keys explain'"
    )
    assert not refusal("operator", "ask", "calibration")
    assert "may not appear as 'gateway', 'gateway', 'run' may" in refusal("viewer", "appear", "gateway")

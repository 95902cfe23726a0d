"""The table of roles: no cell is needless, and a refusal names the roles that may."""

import pytest

from canskin.errors import InputError
from canskin.roles import ACTIONS, QUESTIONS, ROLES, TOPICS, Holder, holder_of, refusal, roles_for


def test_every_topic_and_question_has_who_gives_and_who_takes() -> None:
    for topic in TOPICS:
        assert roles_for("put", topic.name)
        assert roles_for("subscribe", topic.name)
    for question in QUESTIONS:
        assert roles_for("answer", question.name) == ["gateway"]
        assert roles_for("ask", question.name)


def test_a_person_may_all_that_programs_of_persons_may() -> None:
    for role in ("viewer", "recorder", "client", "ros2"):
        for action in ACTIONS:
            assert set(ROLES[role].names(action)) <= set(ROLES["operator"].names(action))


def test_a_refusal_names_the_own_role_and_those_that_may() -> None:
    assert refusal("client", "ask", "calibration") == (
        "the keys are of role 'client', which may not ask 'calibration': 'ros2', 'operator' may, see 'skin keys"
        " explain'"
    )
    assert not refusal("operator", "ask", "calibration")
    assert "which may not appear as 'gateway': 'gateway' may" in refusal("viewer", "appear", "gateway")


@pytest.mark.parametrize("name", ["palm:client", "palm:operator:anna's laptop: left"])
def test_a_common_name_tells_skin_role_and_holder(name: str) -> None:
    assert holder_of(name).common_name == name
    assert holder_of("palm:client:7") == Holder("palm", "client", "7")


@pytest.mark.parametrize("name", ["", "palm", "palm:", ":client", "palm:king", "palm:client:"])
def test_another_name_is_no_holder(name: str) -> None:
    with pytest.raises(InputError, match="expected SKIN:ROLE or SKIN:ROLE:HOLDER"):
        holder_of(name)

"""Names of ROS 2, and the answers to wrong ones."""

import pytest

from canskin.errors import InputError
from shell.command import main
from views.ros2.names import check_domain, check_namespace, parse_attachment
from views.ros2.types import IMAGE, key_type


@pytest.mark.parametrize(("environment", "given", "domain"), [(None, None, 0), ("42", None, 42), ("42", 7, 7)])
def test_domain_is_the_given_one_else_that_of_the_environment(
    monkeypatch: pytest.MonkeyPatch, environment: str | None, given: int | None, domain: int
) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    if environment is not None:
        monkeypatch.setenv("ROS_DOMAIN_ID", environment)
    assert check_domain(given) == domain


def test_a_wrong_domain_names_where_it_came_from(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "many")
    with pytest.raises(InputError, match="ROS_DOMAIN_ID: expected 0 to 232, got many"):
        check_domain(None)
    with pytest.raises(InputError, match="--domain: expected 0 to 232, got 233"):
        check_domain(233)


@pytest.mark.parametrize(
    ("given", "namespace"), [("palm", "/palm"), ("/arm/palm/", "/arm/palm"), ("/", "/"), ("", "/")]
)
def test_namespace_has_a_leading_slash(given: str, namespace: str) -> None:
    assert check_namespace(given) == namespace


@pytest.mark.parametrize("given", ["a b", "/arm//palm", "7up", "ä"])
def test_a_wrong_namespace_is_an_error(given: str) -> None:
    with pytest.raises(InputError, match="--namespace: expected"):
        check_namespace(given)


def test_humble_has_no_type_hashes() -> None:
    # rmw_zenoh_cpp of Humble: the constant of its type_support_common.hpp
    assert key_type(IMAGE, has_hash=False) == "sensor_msgs::msg::dds_::Image_/TypeHashNotSupported"


@pytest.mark.parametrize("content", [b"", b"x" * 33, b"\0" * 16 + b"\x11" + b"\0" * 16])
def test_an_attachment_of_another_form_is_none(content: bytes) -> None:
    assert parse_attachment(content) is None


def test_wrong_options_end_with_2(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for options, words in ((["--domain", "999"], "--domain"), (["--router", "robot"], "endpoint")):
        monkeypatch.setattr("sys.argv", ["skin", "ros2", "--connect", "nowhere", *options])
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 2
        assert words in capsys.readouterr().err

"""What is an address, and what a file."""

import re
from pathlib import Path

import pytest

from canskin.errors import InputError
from views.show.target import Address, foxglove_target, rerun_target


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", None),
        ("rerun+http://robot:9876/proxy", "rerun+http://robot:9876/proxy"),
        ("localhost:9876", "rerun+http://localhost:9876/proxy"),
        ("9876", "rerun+http://127.0.0.1:9876/proxy"),
        ("[::1]:9876", "rerun+http://[::1]:9876/proxy"),
    ],
)
def test_viewers_of_rerun(text: str, expected: str | None) -> None:
    assert rerun_target(text) == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", Address("127.0.0.1", 8766)),
        ("0.0.0.0:0", Address("0.0.0.0", 0)),  # noqa: S104 - the user's own choice
        ("8766", Address("127.0.0.1", 8766)),
        (":8766", Address("127.0.0.1", 8766)),
        ("[::1]:65535", Address("[::1]", 65535)),
    ],
)
def test_addresses_for_foxglove(text: str, expected: Address) -> None:
    assert foxglove_target(text, insecure=True) == expected


@pytest.mark.parametrize("text", ["0.0.0.0:8766", "[::]:8766", "10.0.0.5:8766", "robot:8766"])
def test_a_network_may_see_the_skin_in_foxglove_only_if_the_user_says_so(text: str) -> None:
    with pytest.raises(InputError, match="expected an address of loopback"):
        foxglove_target(text)


def test_new_files(tmp_path: Path) -> None:
    assert rerun_target(str(tmp_path / "run.rrd")) == tmp_path / "run.rrd"
    assert foxglove_target(str(tmp_path / "run:1.mcap")) == tmp_path / "run:1.mcap"


@pytest.mark.parametrize("text", ["rerun+http://nonsense", "ws://robot:9876/proxy", "robot:65536", "robot", "1.2.3.4"])
def test_what_is_no_viewer_of_rerun_is_an_error(text: str) -> None:
    with pytest.raises(InputError, match=f"^{re.escape(text)}: expected"):
        rerun_target(text)


@pytest.mark.parametrize("text", ["127.0.0.1:99999", "ws://127.0.0.1:8766", "localhost:", "::1:8766"])
def test_what_is_no_address_for_foxglove_is_an_error(text: str) -> None:
    with pytest.raises(InputError, match=f"^{re.escape(text)}: expected"):
        foxglove_target(text)

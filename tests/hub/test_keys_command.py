"""``skin keys``: folders for each role, private files, and a list of who may connect."""

import shutil
import stat
from pathlib import Path

import pytest
from cryptography import x509

from canskin.errors import InputError
from canskin.keys import Keys
from canskin.roles import ROLES
from hub.holders import read_holders
from hub.keys_command import add, list_, new, renew, revoke


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "keys"
    new(folder, skin="palm", host=("robot.local", "10.0.0.5"))
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    return shutil.copytree(made, tmp_path / "keys")


def certificate(folder: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate((folder / "cert.pem").read_bytes())


def hosts(folder: Path) -> list[str]:
    names = certificate(folder).extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    return [str(each.value) for each in names]


def test_each_role_has_keys_of_its_own(folder: Path) -> None:
    assert {each.name for each in folder.iterdir()} == {"authority", "holders.json", "hub", *ROLES}
    for role in ("hub", *ROLES):
        assert Keys(folder / role).common_name == f"palm:{role}"
    assert hosts(folder / "hub") == ["localhost", "127.0.0.1", "::1", "robot.local", "10.0.0.5"]


def test_only_the_hub_can_be_a_server(folder: Path) -> None:
    with pytest.raises(x509.ExtensionNotFound):
        hosts(folder / "client")
    usage = certificate(folder / "client").extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert [each._name for each in usage] == ["clientAuth"]


def test_folders_and_private_keys_are_the_users_alone(folder: Path) -> None:
    renew(folder, "client")
    private = [folder, *(path for path in folder.rglob("*") if path.is_dir() or path.name == "key.pem")]
    assert len(private) == 1 + 2 * (2 + len(ROLES))
    assert not [path for path in private if stat.S_IMODE(path.stat().st_mode) & 0o077]


def test_no_authority_is_written_over(folder: Path) -> None:
    before = (folder / "authority" / "key.pem").read_bytes()
    with pytest.raises(InputError, match="no authority is written over"):
        new(folder, skin="palm")
    assert (folder / "authority" / "key.pem").read_bytes() == before


def test_holders_are_added_renewed_and_revoked_alone(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    add(folder, "client:laptop7", "operator:anna")
    assert f"copy {folder / 'hub'} to the hub's machine, and start the hub again" in capsys.readouterr().out
    (folder / "hand.gateway").mkdir()
    add(folder, "hand:gateway")
    assert Keys(folder / "client.laptop7").holder == "laptop7"
    assert Keys(folder / "hand.gateway").common_name == "hand:gateway"
    with pytest.raises(InputError, match="has keys: 'skin keys renew'"):
        add(folder, "client:laptop7")
    before = certificate(folder / "client").serial_number
    renew(folder, "hub", host=("robot2.local",))
    assert hosts(folder / "hub")[-1] == "robot2.local"
    renew(folder)
    assert certificate(folder / "client").serial_number != before
    assert hosts(folder / "hub")[-1] == "robot2.local"
    revoke(folder, "client:laptop7")
    assert f"copy {folder / 'hub'}" in capsys.readouterr().out
    for again in (add, renew):
        with pytest.raises(InputError, match=r"has keys|revoked for good"):
            again(folder, "client:laptop7")
    assert Keys(folder / "hub").common_name == "palm:hub"
    for place in (folder, folder / "hub"):  # the hub makes its rules of a copy
        names = read_holders(place).allowed
        assert "palm:operator:anna" in names
        assert "hand:gateway" in names
        assert "palm:client:laptop7" not in names


def test_the_hubs_keys_are_neither_revoked_nor_added(folder: Path) -> None:
    before = (folder / "holders.json").read_bytes()
    with pytest.raises(InputError, match="make a new authority"):
        revoke(folder, "client", "hub")
    for name in ("hub:two", "hand:hub", "hub:gateway"):
        with pytest.raises(InputError, match=f"the hub has keys: 'skin keys renew {folder} hub'"):
            add(folder, name)
    assert (folder / "holders.json").read_bytes() == before
    assert not list(folder.glob("*hub?*"))


def test_the_list_tells_who_is_revoked(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    revoke(folder, "viewer")
    capsys.readouterr()
    list_(folder)
    line = next(line for line in capsys.readouterr().out.splitlines() if "viewer" in line)
    assert line.split()[:2] == ["palm", "viewer"]
    assert line.endswith("revoked")


@pytest.mark.parametrize(
    "name", ["king", "client:", "client:../x", "../x:client", "Palm:client", "palm:king:x", "client:" + "x" * 60]
)
def test_names_that_are_none(folder: Path, name: str) -> None:
    with pytest.raises(InputError, match="expected ROLE, ROLE:HOLDER or SKIN:ROLE:HOLDER"):
        add(folder, name)


def test_what_is_not_there(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no keys: see 'skin keys list'"):
        revoke(folder, "client:nobody")
    with pytest.raises(InputError, match="expected ROLE or ROLE:HOLDER, got none"):
        revoke(folder)
    with pytest.raises(InputError, match=r"^--skin pa\*\*lm: expected the name of the skin"):
        new(tmp_path / "other", skin="pa**lm")
    with pytest.raises(InputError, match="--skin hub: a role has that name"):
        new(tmp_path / "other", skin="hub")
    with pytest.raises(InputError, match="expected the name or the address"):
        new(tmp_path / "other", skin="palm", host=("a b",))
    with pytest.raises(InputError, match="expected the list that 'skin keys new' makes"):
        list_(tmp_path)
    (folder / "authority" / "key.pem").write_text("secret")
    with pytest.raises(InputError, match=r"a file of the authority is damaged$"):
        add(folder, "client:laptop7")


def test_a_folder_that_others_may_open_is_closed_before_its_key_is_written(folder: Path) -> None:
    (folder / "client").chmod(0o755)
    renew(folder, "client")
    assert stat.S_IMODE((folder / "client").stat().st_mode) == 0o700

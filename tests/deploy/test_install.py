"""The installation of services: what it writes, what it leaves alone, and that the host's programs understand it."""

import configparser
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from canskin.errors import InputError
from canskin.keys import Keys
from deploy.configuration import ROLES, Adapter, write
from hub.keys_command import new
from skin.layout import load_layout
from tests.deploy.conftest import ROOT, Install
from tests.deploy.units import Unit
from tests.layouts import layout_toml
from tests.processes import Processes

NETWORKS = "etc/systemd/network"
NETWORKD = Path("/lib/systemd/systemd-networkd")


def network(root: Path, name: str) -> dict[str, dict[str, str]]:
    """Return the sections of the file of an interface."""
    parser = configparser.ConfigParser(interpolation=None)
    parser.optionxform = str  # type: ignore[assignment,method-assign]  # names as they are
    parser.read_string((root / NETWORKS / f"20-canskin-{name}.network").read_text())
    return {section: dict(parser[section]) for section in parser.sections()}


def files(root: Path) -> set[str]:
    return {str(path.relative_to(root)) for path in root.rglob("*") if path.is_file()}


@pytest.mark.heavy
def test_interfaces_get_the_bit_rates_of_the_layout(installed: Path, install: Install, tmp_path: Path) -> None:
    names = [f"skin{number}" for number in range(4)]
    assert sorted(path.name for path in (installed / NETWORKS).iterdir()) == [
        f"20-canskin-{name}.network" for name in names
    ]
    for name in names:
        assert network(installed, name)["Match"] == {"Name": name, "Type": "can"}
        assert network(installed, name)["CAN"] == {"BitRate": "1000000", "SamplePoint": "75%", "RestartSec": "100ms"}
    assert install(tmp_path, "--layout", "fd", "--interface", "can3").returncode == 0
    can = network(tmp_path, "can3")["CAN"]
    assert (can["BitRate"], can["FDMode"], can["DataBitRate"]) == ("1000000", "yes", "5000000")
    assert "-c can3 " in (tmp_path / "etc/canskin/skin.env").read_text()


@pytest.mark.heavy
def test_again_changes_nothing_and_removal_leaves_nothing(install: Install, tmp_path: Path) -> None:
    first = install(tmp_path)
    assert "installed  /etc/canskin/skin.env" in first.stdout
    restart = "  systemctl restart skin.target\n"
    assert restart not in first.stdout
    before = {name: (tmp_path / name).read_bytes() for name in files(tmp_path)}
    again = install(tmp_path)
    assert "installed" not in again.stdout
    assert restart in again.stdout  # what runs has the files of before
    assert {name: (tmp_path / name).read_bytes() for name in files(tmp_path)} == before
    # Another interface: the file of the old interface goes.
    assert (
        "removed    /etc/systemd/network/20-canskin-can0.network"
        in install(tmp_path, "--layout", "fd", "--interface", "can1").stdout
    )
    assert install(tmp_path, "--remove").returncode == 0
    assert files(tmp_path) == set()
    assert not (tmp_path / "etc/canskin").exists()


@pytest.mark.heavy
def test_a_file_that_was_changed_by_hand_stays(install: Install, tmp_path: Path) -> None:
    install(tmp_path)
    environment = tmp_path / "etc/canskin/skin.env"
    own = environment.read_text().replace("SKIN_view=", "SKIN_view=--port 80")
    environment.write_text(own)
    for _ in range(2):  # the second run must not take the change for its own
        done = install(tmp_path)
        assert "kept       /etc/canskin/skin.env" in done.stdout
        assert environment.read_text() == own
        assert "SKIN_view=\n" in environment.with_name("skin.env.new").read_text()
    install(tmp_path, "--remove")
    assert files(tmp_path) == {"etc/canskin/skin.env"}
    assert environment.read_text() == own


@pytest.mark.heavy
def test_each_service_gets_the_keys_of_its_role_and_no_other(install: Install, tmp_path: Path) -> None:
    root, given = tmp_path / "root", tmp_path / "keys"
    new(given, skin="skin")
    assert " skin@hub skin@run skin@classify " in install(root, "--keys", str(given)).stdout
    roles = {"hub", "run", "gateway", "reconstructor", "classifier", "operator", "recorder", "ros2", "viewer"}
    assert {path.name for path in (root / "etc/canskin/keys").iterdir()} == roles
    for verb, role in ROLES.items():
        (line,) = (word for word in Unit(root, verb).settings["Environment"] if word.startswith("SKIN_KEYS="))
        keys = root / line.partition("=/")[2]
        assert (Keys(keys).common_name, keys.stat().st_mode & 0o777) == (f"skin:{role}", 0o700)
        assert all(path.stat().st_mode & 0o777 == 0o600 for path in keys.iterdir())
    assert Unit(root, "hub").command()[1:] == ["hub", "--listen", "tls/0.0.0.0:7447"]
    for verb in ("run", "gateway"):
        assert "--connect tls/127.0.0.1:7447" in " ".join(Unit(root, verb).command())
    install(root, "--remove")
    assert files(root) == set()


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("words", "means"),
    [
        (["--keys", "nosuchdir"], "--keys nosuchdir: expected a folder that skin keys new has made"),
        (["--bitrate", "500000"], "--help"),
        (["--layout"], "expected a value"),
        (["--layout", "absent.toml"], "absent.toml"),
        (["--remove"], "nothing is installed"),
    ],
)
def test_a_wrong_call_is_one_line_and_installs_nothing(
    install: Install, tmp_path: Path, words: list[str], means: str
) -> None:
    done = install(tmp_path, *words)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("deploy/install: ")
    assert means in line
    assert files(tmp_path) == set()


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("skin0=0042A7:1", 'ATTRS{serial}=="0042A7", ATTR{dev_id}=="0x1", NAME="skin0"'),
        ("skin1=@1-2.3", 'KERNELS=="1-2.3", ATTR{dev_id}=="0x0", NAME="skin1"'),
    ],
)
def test_an_adapter_is_known_by_its_serial_number_or_its_port(text: str, rule: str) -> None:
    assert Adapter.from_text(text).rule.endswith(f"{rule}\n")


@pytest.mark.parametrize(
    ("words", "means"),
    [
        (["--interface", "can0", "can1"], "expected 4 channels"),
        (["--interface", "skin0", "--adapter", "skin0"], "NAME=SERIAL"),
        (["--interface", "can0", "--adapter", "can0=0042A7"], "the kernel gives"),
        (["--interface", "can0", "--adapter", "skin0=0042A7"], "can0, can1, can2, can3"),
        (["--interface", "can/0"], "without space"),
        (["--interface", "skin0", "--adapter", "skin0=0042A7", "skin0=0042A8"], "each channel once, got skin0"),
        (["--interface", "skin0", "--adapter", "skin0=0042A7", "skin1=0042A7"], "equal serial numbers, or none, need"),
        (
            ["--interface", "can0", "--programs", "/usr/bin/python3", "/root/venv/"],
            "/root/venv/: .* a Python of the system",
        ),
    ],
)
def test_what_the_services_cannot_use_is_refused(tmp_path: Path, words: list[str], means: str) -> None:
    with pytest.raises(InputError, match=means):
        write(["--layout", "default", "--venv", "/opt/canskin", "--folder", str(tmp_path), *words])
    assert files(tmp_path) == set()


def test_a_layout_in_a_home_folder_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "palm.toml").write_text(layout_toml())
    monkeypatch.setattr("deploy.configuration.HOMES", (str(tmp_path),))
    with pytest.raises(InputError, match="copy the layout to /etc/canskin"):
        write(
            ["--layout", str(tmp_path / "palm.toml"), "--interface", "can0", "--venv", "/v", "--folder", str(tmp_path)]
        )


@pytest.fixture
def host(installed: Path, request: pytest.FixtureRequest) -> list[str]:
    """Words for a program that sees an installed folder as that of its host, in a network of its own."""
    folder = request.param
    if not Path("/", folder).is_dir():
        pytest.skip(f"NOT TESTED: needs a host with /{folder}")
    if os.geteuid() != 0 or subprocess.run(["unshare", "--mount", "--net", "true"], check=False).returncode:
        pytest.skip("NOT TESTED: needs root, and namespaces of mounts and networks")
    mounts = f'mount --bind "{installed}/{folder}" /{folder}; mount -t sysfs sysfs /sys'
    return ["unshare", "--mount", "--net", "sh", "-euc", f'{mounts}; exec "$@"', "-"]


@pytest.mark.heavy
@pytest.mark.skipif(shutil.which("udevadm") is None, reason="NOT TESTED: udevadm is missing (Debian: udev)")
@pytest.mark.parametrize("host", ["etc/udev/rules.d"], indirect=True)
def test_udev_understands_the_rules(host: list[str], installed: Path) -> None:
    done = subprocess.run([*host, "udevadm", "test", "/sys/class/net/lo"], capture_output=True, text=True, check=False)
    said = done.stdout + done.stderr
    rules = "/etc/udev/rules.d/76-canskin.rules"
    assert [line for line in said.splitlines() if rules in line] == [f"Reading rules file: {rules}"]


@pytest.mark.heavy
@pytest.mark.skipif(not NETWORKD.exists(), reason="NOT TESTED: systemd-networkd is missing (Debian: systemd)")
@pytest.mark.parametrize("host", [NETWORKS], indirect=True)
def test_networkd_understands_the_interfaces(host: list[str], tmp_path: Path) -> None:
    quiet = {"SYSTEMD_LOG_TARGET": "console", "SYSTEMD_LOG_LEVEL": "debug"}
    with Processes(tmp_path) as processes:
        processes.start("networkd", *host, str(NETWORKD), environment=quiet)
        processes.await_words("networkd", "Enumeration completed")
        said = processes.log("networkd").read_text(errors="replace")
    assert not re.search(r"20-canskin\S*:\d+:", said), said  # a complaint names file and line


@pytest.mark.slow
@pytest.mark.skipif("SKIN_WHEELS" not in os.environ, reason="NOT TESTED: SKIN_WHEELS names no folder of wheels")
def test_an_environment_is_made_without_a_network(tmp_path: Path) -> None:
    script, wheels = str(ROOT / "deploy/install"), os.environ["SKIN_WHEELS"]
    no_network = ["unshare", "--net", script, "--root", str(tmp_path), "--wheels", wheels, "--layout", "fd"]
    done = subprocess.run(no_network, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    scripts = (tmp_path / "opt/canskin/bin/skin").read_text()
    assert scripts.startswith("#!/opt/canskin/bin/python")
    subprocess.run([script, "--root", str(tmp_path), "--remove"], check=True)
    assert files(tmp_path) == set()


@pytest.mark.parametrize("words", [[], ["--remove"]])
@pytest.mark.parametrize("root", ["file", "file/below", ""])
def test_a_root_that_cannot_be_is_never_the_host(root: str, words: list[str], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    # Without a Python and without systemd's folders the script could change nothing here, were the root lost.
    calls = {"PATH": os.environ["PATH"], "PYTHON": "/bin/false"}
    command = [str(ROOT / "deploy/install"), "--root", root and str(tmp_path / root), *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=calls)
    assert done.returncode == 2
    assert done.stderr.startswith("deploy/install: --root")
    assert files(tmp_path) == {"file"}


def test_removal_takes_no_other_options(install: Install, tmp_path: Path) -> None:
    done = install(tmp_path, "--layout", "fd", "--remove")
    assert (done.returncode, "got --layout" in done.stderr) == (2, True)


@pytest.mark.parametrize(
    ("words", "means"),
    [
        (["--wheels", "nosuchdir"], "--wheels nosuchdir: expected a folder with wheels"),
        (["--layout", "absent.toml"], "--layout absent.toml: expected a file"),
        ([], ""),  # pip fails
    ],
)
def test_a_failed_installation_leaves_nothing(words: list[str], means: str, tmp_path: Path) -> None:
    # A Python whose environments have a python that fails.
    python = tmp_path / "python"
    python.write_text('#!/bin/sh\n[ "$2" != venv ] || { mkdir -p "$3/bin"; ln -s /bin/false "$3/bin/python"; }\n')
    python.chmod(0o755)
    root = tmp_path / "root"
    command = [str(ROOT / "deploy/install"), "--root", str(root), *words]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env=os.environ | {"PYTHON": str(python)}
    )
    assert done.returncode != 0
    assert means in done.stderr
    assert ("making" in done.stdout) == (not words)
    assert files(root) == set()
    assert not (root / "opt/canskin").exists()


def test_what_a_killed_installation_left_is_removed(install: Install, tmp_path: Path) -> None:
    made = tmp_path / "opt/canskin/.made-by-deploy-install"
    made.parent.mkdir(parents=True)
    made.touch()
    assert install(tmp_path, "--remove").returncode == 0
    assert not made.parent.exists()


def configure(folder: Path, *words: str) -> None:
    write(["--venv", "/opt/canskin", "--folder", str(folder), *words])


@pytest.mark.parametrize(
    ("words", "means"),
    [
        (["--layout", "fd", "--interface", "can0"], "SKIN_LAYOUT=default.*give its --layout"),
        (["--layout", "default", "--interface", "can4"], "-c can0 can1 can2 can3.*give its --interface"),
    ],
)
def test_a_changed_environment_of_another_layout_is_refused(words: list[str], means: str, tmp_path: Path) -> None:
    configure(tmp_path / "first", "--layout", "default", "--interface", "can0")
    kept = ["--kept", str(tmp_path / "first/etc/canskin/skin.env")]
    configure(tmp_path / "again", "--layout", "default", "--interface", "can0", *kept)
    with pytest.raises(InputError, match=means):
        configure(tmp_path / "other", *words, *kept)
    assert files(tmp_path / "other") == set()


def test_a_changed_environment_with_an_adapter_on_a_serial_line_stays(tmp_path: Path) -> None:
    words = ["--layout", "fd", "--interface", "can0"]
    configure(tmp_path, *words)
    environment = tmp_path / "etc/canskin/skin.env"
    environment.write_text(environment.read_text().replace("-i socketcan -c can0", "-i slcan -c /dev/ttyACM0"))
    configure(tmp_path / "again", *words, "--kept", str(environment))
    assert (tmp_path / "again/etc/canskin/skin.env").exists()


def test_a_layout_goes_into_the_root_with_the_files_that_it_names(tmp_path: Path) -> None:
    (tmp_path / "drives.dbc").write_text('VERSION ""\nBO_ 1413 Answer: 8 Drive\n')
    (tmp_path / "palm.toml").write_text(layout_toml(bus=[{"name": "arm", "nodes": 2, "foreign_dbc": "drives.dbc"}]))
    root, given = tmp_path / "root", ["--interface", "can0", "--root", str(tmp_path / "root")]
    configure(root, "--layout", str(tmp_path / "palm.toml"), *given)
    assert "SKIN_LAYOUT=/etc/canskin/palm.toml\n" in (root / "etc/canskin/skin.env").read_text()
    copy = root / "etc/canskin/palm.toml"
    assert load_layout(copy) == load_layout(tmp_path / "palm.toml")
    # A layout that is in the root already is no copy.
    configure(tmp_path / "again", "--layout", str(copy), *given)
    assert "SKIN_LAYOUT=/etc/canskin/palm.toml\n" in (tmp_path / "again/etc/canskin/skin.env").read_text()
    assert not (tmp_path / "again/etc/canskin/palm.toml").exists()

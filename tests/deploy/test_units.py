"""The units of systemd: valid, careful, and with commands that make a whole skin when they run confined as they say."""

import errno
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from canskin.keys import ENVIRONMENT, UNIX
from health.alive import trouble
from hub.keys_command import new
from tests.deploy.conftest import Install
from tests.deploy.units import UNITS, Unit
from tests.layouts import slow_layout
from tests.processes import Processes, free_port
from tests.readonly import give_compiled, gives_real_time, not_here
from tests.system.helpers import first_image

VERBS = ("run", "classify", "view", "record")
INSTANCES = (*VERBS, "gateway", "reconstruct", "ros2", "metrics")
#: Exposure of a unit by `systemd-analyze security`, in tenths: 0 is none, 100 all.
EXPOSURE_MAX = 20
#: Where the services keep kernels, and the module of the gateway whose kernels are not there before.
CACHE, COMPILED_THERE = "writable/var/cache/canskin", "batch"
pytestmark = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="NOT TESTED: systemd-analyze is missing (Debian: systemd)"
)


@pytest.fixture(scope="module")
def units(installed: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The installed units, each instance by its name, as `systemctl enable` links them."""
    folder = tmp_path_factory.mktemp("units") / "system"
    shutil.copytree(installed / UNITS, folder)
    for verb in INSTANCES:
        (folder / f"skin@{verb}.service").symlink_to("skin@.service")
    return folder


@pytest.mark.heavy
def test_systemd_understands_every_unit(units: Path) -> None:
    names = ["skin.target", *(f"skin@{verb}.service" for verb in INSTANCES)]
    command = ["systemd-analyze", "verify", "--man=no", "--recursive-errors=no", *(str(units / name) for name in names)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    # Of an unknown setting it only warns; units of this machine's own may have warnings of theirs.
    assert [line for line in (done.stdout + done.stderr).splitlines() if "skin" in line] == []
    assert done.returncode == 0


@pytest.mark.heavy
@pytest.mark.parametrize("verb", INSTANCES)
def test_no_unit_gets_more_than_it_needs(units: Path, verb: str) -> None:
    options = ["--offline=yes", f"--threshold={EXPOSURE_MAX}", "--no-pager"]
    unit = str(units / f"skin@{verb}.service")
    done = subprocess.run(["systemd-analyze", "security", *options, unit], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_only_services_of_the_buses_open_can_sockets(installed: Path) -> None:
    allowed = {verb: " ".join(Unit(installed, verb).settings["RestrictAddressFamilies"]).split() for verb in INSTANCES}
    assert {verb for verb, families in allowed.items() if "AF_CAN" in families} == {"run", "gateway", "record"}


#: Prints the numbers of the errors of what a service must not do, its user, and whether it has a capability.
TRIES = """
import os, socket
for forbidden in (lambda: open("/etc/own", "w"), lambda: socket.socket(socket.AF_PACKET), lambda: os.chroot("/tmp")):
    try:
        print(forbidden())
    except OSError as error:
        print(error.errno)
held = [line for line in open("/proc/self/status") if line.startswith("Cap")]
print(os.getuid(), any(int(line.split()[1], 16) for line in held))
"""


@pytest.mark.heavy
def test_a_confined_service_can_do_nothing_more(installed: Path, tmp_path: Path) -> None:
    if why := not_here():
        pytest.skip(why)
    words = Unit(installed, "view").confined(tmp_path).words(sys.executable, "-I", "-c", TRIES)
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.stdout.split() == [*map(str, (errno.EROFS, errno.EAFNOSUPPORT, errno.EPERM, 10001)), "False"], (
        done.stderr
    )


@contextmanager
def running(root: Path, more: dict[str, str], *instances: str) -> Iterator[Processes]:
    """Run the ExecStart= of each unit, confined as the unit says, on virtual buses; skin.env is edited by hand."""
    if why := not_here():
        pytest.skip(why)
    folder = root.parent
    slow_layout(root / "etc/canskin", 20).rename(root / "etc/canskin/slow.toml")
    give_compiled(folder / CACHE, but=COMPILED_THERE)
    environment = root / "etc/canskin/skin.env"
    text = environment.read_text().replace("SKIN_LAYOUT=default", "SKIN_LAYOUT=/etc/canskin/slow.toml")
    text = re.sub("-i socketcan -c .*", "-i canskin", text)
    environment.write_text(text + "".join(f"SKIN_{verb}={words}\n" for verb, words in more.items()))
    with Processes(folder) as processes:
        bus = Unit(root, "bus")
        skin = bus.command()[0]
        processes.start("bus", *bus.confined(folder / "writable").words(skin, "bus"))
        processes.await_words("bus", "ready")
        for verb in ("nodes", *instances):
            unit = Unit(root, verb)
            processes.start(verb, *unit.confined(folder / "writable").words(*unit.command()))
        yield processes


@pytest.mark.slow
def test_units_run_confined_as_they_say(installed: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(installed, tmp_path / "root"))
    more = {
        "gateway": "--keep-zero /var/lib/canskin/zero.json",
        "view": f"--port {free_port()}",
        "record": "-i canskin",
    }
    with running(root, more, *VERBS) as processes:
        processes.await_words("run", "gateway: scheduling")
        first_image(processes, f"{UNIX}/{processes.folder}/writable/run/canskin/hub")
        processes.await_words("view", "web page")
        wanted = "scheduling: real time" if gives_real_time() else "scheduling: ordinary"
        for verb, service in (
            ("run", "gateway"),
            ("run", "reconstructor"),
            ("classify", "classifier"),
            ("record", "record"),
        ):
            assert processes.log(verb).read_text().count(f"{service}: {wanted}") == 1, service
        for verb in VERBS:
            assert processes.stop(verb) == 0, processes.log(verb).read_text()
        kept = processes.folder / "writable/var/lib/canskin"
        assert len(list(kept.glob("*.mcap"))) == 1
        assert list((processes.folder / CACHE).rglob(f"{COMPILED_THERE}.*.nbi"))


@pytest.mark.slow
def test_units_with_keys_meet_at_the_hub(install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    new(tmp_path / "keys", skin="skin")
    assert install(tmp_path / "root", "--interface", "skin0", "--keys", str(tmp_path / "keys")).returncode == 0
    endpoint = f"tls/127.0.0.1:{free_port()}"
    more = dict.fromkeys(("reconstruct", "view"), f"--connect {endpoint}")
    more |= {"hub": f"--listen {endpoint}", "gateway": f"-i canskin --connect {endpoint}", "nodes": "--no-fabric"}
    more["view"] += f" --port {free_port()}"
    with running(tmp_path / "root", more, "hub", "gateway", "reconstruct", "view") as processes:
        processes.await_words("view", "web page")
        with monkeypatch.context() as patch:
            patch.setenv(ENVIRONMENT, str(tmp_path / "keys/reconstructor"))
            processes.until(lambda: not trouble("reconstructor", endpoint), "images")

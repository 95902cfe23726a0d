"""The compose file: valid, careful, and with commands that make a whole skin when they are run as written.

The commands run as in their containers, but without an engine: on a disk that cannot be written, without capabilities,
as the image's user and with its environment. `tests/containers` has the engine.
"""

import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML

from canskin.keys import UNIX
from canskin.roles import ROLES
from tests.layouts import slow_layout
from tests.processes import PATIENCE_S, Processes, free_port
from tests.readonly import Confined, give_compiled, not_here
from tests.system.helpers import first_image

ROOT = Path(__file__).parents[2]
COMPOSE, WITH_KEYS = ROOT / "docker-compose.yml", ROOT / "docker-compose.keys.yml"
IN_ORDER_OF_THE_DATA = ["nodes", "gateway", "reconstructor", "classifier", "viewer"]
SETTINGS = dict(line.split("=", 1) for line in (ROOT / ".env").read_text().splitlines() if not line.startswith("#"))
Service = dict[str, Any]


@pytest.fixture(scope="module")
def services() -> dict[str, Service]:
    services: dict[str, Service] = YAML(typ="safe").load(COMPOSE)["services"]
    return services


def filled(text: str, **settings: str) -> str:
    """Put settings in the places of the variables; each has a line in `.env`."""
    return re.sub(r"\$\{(\w+)(?::\?[^}]*)?\}", lambda name: {**SETTINGS, **settings}[name[1]], text)


def of_profile(services: dict[str, Service], profile: str) -> dict[str, Service]:
    return {name: service for name, service in services.items() if profile in service["profiles"]}


@pytest.mark.heavy
def test_the_files_are_valid_by_the_compose_specification() -> None:
    files = [str(COMPOSE), str(WITH_KEYS)]
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec", *files]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_each_profile_is_a_whole_skin_in_the_order_of_the_data(services: dict[str, Service]) -> None:
    assert list(of_profile(services, "virtual")) == IN_ORDER_OF_THE_DATA
    # A host with CAN needs no virtual bus, a robot no virtual nodes: they would answer as its boards.
    robot = ["skin-can", "classifier-can", "viewer-can"]
    assert list(of_profile(services, "robot")) == robot
    assert list(of_profile(services, "vcan")) == ["nodes-vcan", *robot]
    assert len(services) == 9
    assert SETTINGS["COMPOSE_PROFILES"] == "virtual"


def test_every_service_of_a_skin_has_the_layout_of_one_variable_and_a_place_for_its_kernels(
    services: dict[str, Service],
) -> None:
    for name, service in services.items():
        assert {"cache:/var/cache/canskin", "${SKIN_FILES}:/etc/canskin:ro"} <= set(service["volumes"]), name
        words = shlex.split(filled(service["command"], SKIN_LAYOUT="palm.toml"))
        assert words[1:3] == ["--layout", "palm.toml"], name


def test_an_interface_without_a_name_is_refused_by_compose(services: dict[str, Service]) -> None:
    # Not `-c` and nothing after it. `.env` gives the other profiles a value, which compose asks for in each profile.
    uses = [each["command"] for each in services.values() if "SKIN_CAN" in each["command"]]
    assert len(uses) == 2
    assert all("-c ${SKIN_CAN:?" in each for each in uses)
    assert SETTINGS["SKIN_CAN"]


def test_with_keys_every_service_of_a_robot_has_those_of_a_role(services: dict[str, Service]) -> None:
    changed: dict[str, Service] = YAML(typ="safe").load(WITH_KEYS)["services"]
    assert set(changed) == {"hub-can", *of_profile(services, "vcan")}
    folders = {Path(service["environment"]["SKIN_KEYS"]) for service in changed.values()}
    assert len(folders) == len(changed)
    assert {folder.name for folder in folders} <= {"hub", *ROLES}
    listening = services["skin-can"]["command"].replace("--listen", "--connect")
    assert changed["skin-can"]["command"] == listening


def test_every_setting_is_used(services: dict[str, Service]) -> None:
    used = set(re.findall(r"\$\{(\w+)[}:]", COMPOSE.read_text()))
    assert used == {name for name in SETTINGS if name.startswith("SKIN_")}


def test_the_lock_names_one_version_of_every_package_that_the_image_needs() -> None:
    lines = (ROOT / "requirements.lock").read_text().splitlines()
    assert all(re.fullmatch(r"[a-z0-9-]+==[^ ]+( ; .+)?", line) for line in lines)
    locked = {line.split("==")[0] for line in lines}
    for project in (ROOT / "pyproject.toml", ROOT / "client" / "pyproject.toml"):
        about = tomllib.loads(project.read_text())["project"]
        for needed in about["dependencies"] + about.get("optional-dependencies", {}).get("metrics", []):
            name = re.split(r"[<>=]", needed)[0].lower()
            assert name in {*locked, "canskin-client"}, needed


def test_no_service_gets_more_than_it_needs(services: dict[str, Service]) -> None:
    for name, service in services.items():
        assert service["cap_drop"] == ["ALL"], name
        assert service["read_only"], name
        assert "no-new-privileges:true" in service["security_opt"], name
        assert service["restart"] == "unless-stopped", name
        assert service["healthcheck"]["test"], name
        assert {"privileged", "cap_add", "user", "devices"}.isdisjoint(service), name
    assert re.findall(r"^USER (\w+)$", (ROOT / "Dockerfile").read_text(), re.MULTILINE) == ["skin"]


def test_only_the_page_is_published_and_only_on_this_machine(services: dict[str, Service]) -> None:
    published = {name: service["ports"] for name, service in services.items() if "ports" in service}
    assert published == {"viewer": ["127.0.0.1:8765:8765"]}
    for name, service in of_profile(services, "virtual").items():
        assert (service.get("network_mode") == "none") is (name != "viewer"), name
    for name, service in of_profile(services, "vcan").items():
        assert "0.0.0.0" not in service["command"], name  # noqa: S104 - that is what must not be there


def test_the_user_of_the_image_owns_the_buses_sockets() -> None:
    uid = re.search(r"--uid (\d+)", (ROOT / "Dockerfile").read_text())
    options = YAML(typ="safe").load(COMPOSE)["volumes"]["sockets"]["driver_opts"]["o"]
    assert uid is not None
    assert {f"uid={uid[1]}", "mode=0700"} <= set(options.split(","))


def test_the_image_holds_every_package() -> None:
    packages = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    kept = set(re.findall(r"^!(\w+)$", (ROOT / ".dockerignore").read_text(), re.MULTILINE))
    assert kept == {*packages["packages"], "client", "wheels", "LICENSE"}


def image_environment() -> dict[str, str]:
    """Return what the Dockerfile sets, with the programs of this environment."""
    text = (ROOT / "Dockerfile").read_text().split("\nENV PATH")[1].split("\nUSER")[0]
    words = dict(re.findall(r"(\w+)=(\S+)", text))
    assert words["NUMBA_CACHE_DIR"].startswith(words["SKIN_CACHE"] + "/")  # one volume keeps both
    return {**words, "PATH": f"{Path(sys.executable).parent}:/usr/bin:/bin", "HOME": words["SKIN_CACHE"]}


def test_units_and_image_give_the_services_the_same_environment() -> None:
    lines = re.findall(r"^Environment=(.*)$", (ROOT / "deploy/skin@.service").read_text(), re.MULTILINE)
    words = " ".join(lines).replace("%t", "/run").replace("%C", "/var/cache").split()
    of_image = {name: value for name, value in image_environment().items() if name not in {"PATH", "HOME"}}
    assert dict(word.split("=", 1) for word in words) == of_image


@dataclass(frozen=True)
class Boxes:
    """Runs commands of the compose file as in containers: `folder` has the volumes.

    The services share the machine's network: the port of the page is a free one. The skin is the default one at a rate
    that every machine keeps.
    """

    folder: Path
    page_port: str

    def command(self, words: list[str], *, caches: bool = True) -> list[str]:
        """Return what runs `words` in a box; `caches`: the box has the volume of compiled kernels."""
        uid = re.search(r"--uid (\d+)", (ROOT / "Dockerfile").read_text())
        assert uid is not None
        volumes = {"/run/canskin": self.folder / "run"} | (
            {"/var/cache/canskin": self.folder / "cache"} if caches else {}
        )
        return Confined(image_environment(), volumes, user_id=int(uid[1])).words(*map(self._word, words))

    def _word(self, word: str) -> str:
        return re.sub(r"(?<!\d)8765(?!\d)", self.page_port, word)

    def service(self, service: Service, **options: bool) -> list[str]:
        """Return what runs a service."""
        layout = slow_layout(self.folder / "run", 20).name
        return self.command(
            ["skin", *shlex.split(filled(service["command"], SKIN_LAYOUT=f"/run/canskin/{layout}"))], **options
        )

    def is_healthy(self, service: Service) -> bool:
        """Run a health check as written."""
        kind, *command = service["healthcheck"]["test"]
        assert kind == "CMD"
        return subprocess.run(self.command(command), check=False, timeout=PATIENCE_S).returncode == 0


@pytest.fixture(scope="module")
def boxes(tmp_path_factory: pytest.TempPathFactory) -> Boxes:
    if why := not_here():
        pytest.skip(why)
    folder = tmp_path_factory.mktemp("compose")
    (folder / "run").mkdir(mode=0o700)
    give_compiled(folder / "cache")
    return Boxes(folder, str(free_port()))


@pytest.mark.slow
def test_the_commands_as_written_give_measurements_images_and_health(
    services: dict[str, Service], boxes: Boxes
) -> None:
    virtual = of_profile(services, "virtual")
    with Processes(boxes.folder) as running:
        for name, service in virtual.items():
            running.start(name, *boxes.service(service))
        running.await_words("viewer", "web page")  # the hub is there
        image = first_image(running, f"{UNIX}/{boxes.folder}/run/hub")
        assert np.frombuffer(image.pixels, "<f4").size == 64 * 64
        for name, service in virtual.items():
            running.until(lambda service=service: boxes.is_healthy(service), f"{name} to be healthy")  # type: ignore[misc]
        running.stop("nodes")
        assert not boxes.is_healthy(services["gateway"])  # there, but measures no block


@pytest.mark.slow
def test_a_service_runs_where_nothing_at_all_can_be_written(services: dict[str, Service], boxes: Boxes) -> None:
    with Processes(boxes.folder) as running:
        running.start("nodes", *boxes.service(services["nodes"], caches=False))
        running.await_words("nodes", "waits for the fabric's hub")

"""The compose file: valid, careful, and with commands that make a whole skin when they are run as written."""

import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML

from canskin.fabric import Fabric
from canskin.messages import IMAGE, MEASUREMENT, Image, Measurement
from tests.layouts import slow_layout
from tests.processes import Processes, free_endpoint

ROOT = Path(__file__).parents[2]
COMPOSE = ROOT / "docker-compose.yml"
IN_ORDER_OF_THE_DATA = ["bus", "nodes", "gateway", "reconstructor", "classifier", "viewer"]
#: Verbs that read a layout.
IN_THE_SKIN = ("nodes", "gateway", "reconstruct", "classify", "view")
Service = dict[str, Any]


@pytest.fixture(scope="module")
def services() -> dict[str, Service]:
    services: dict[str, Service] = YAML(typ="safe").load(COMPOSE)["services"]
    return services


def of_profile(services: dict[str, Service], profile: str) -> dict[str, Service]:
    return {name: service for name, service in services.items() if service["profiles"] == [profile]}


@pytest.mark.heavy
def test_the_file_is_valid_by_the_compose_specification() -> None:
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec", str(COMPOSE)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_each_profile_is_a_whole_skin_in_the_order_of_the_data(services: dict[str, Service]) -> None:
    assert list(of_profile(services, "virtual")) == IN_ORDER_OF_THE_DATA
    # A host with CAN needs no virtual bus.
    assert list(of_profile(services, "vcan")) == [f"{name}-vcan" for name in IN_ORDER_OF_THE_DATA[1:]]
    assert len(services) == 11
    assert "COMPOSE_PROFILES=virtual" in (ROOT / ".env").read_text().splitlines()


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
    assert YAML(typ="safe").load(COMPOSE)["networks"]["fabric"] == {"internal": True}
    for name, service in of_profile(services, "vcan").items():
        assert "0.0.0.0" not in " ".join(service["command"]), name  # noqa: S104 - that is what must not be there


def test_the_user_of_the_image_owns_the_buses_sockets() -> None:
    uid = re.search(r"--uid (\d+)", (ROOT / "Dockerfile").read_text())
    options = YAML(typ="safe").load(COMPOSE)["volumes"]["sockets"]["driver_opts"]["o"]
    assert uid is not None
    assert {f"uid={uid[1]}", "mode=0700"} <= set(options.split(","))


def test_the_image_holds_every_package() -> None:
    packages = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    kept = set(re.findall(r"^!(\w+)$", (ROOT / ".dockerignore").read_text(), re.MULTILINE))
    assert kept == {*packages["packages"], "client", "LICENSE"}


@dataclass(frozen=True)
class Outside:
    """What the words of a command are outside a container: names are loopback, ports free ones, programs ours.

    The skin is the default one at a rate that every machine keeps.
    """

    folder: Path
    endpoint: str
    page_port: str

    def words(self, command: list[str]) -> list[str]:
        """Translate a command."""
        programs = {"skin-alive": [str(Path(sys.executable).with_name("skin-alive"))], "python": [sys.executable]}
        words = [self._word(word) for word in command]
        if words[0] in IN_THE_SKIN:
            words += ["--layout", str(slow_layout(self.folder, 20))]
        return [*programs.get(words[0], words[:1]), *words[1:]]

    def environment(self) -> dict[str, str]:
        """Translate the image's environment."""
        image = (ROOT / "Dockerfile").read_text().split("\nENV ")[1].split("\nUSER")[0]
        words = {name: self._word(value) for name, value in re.findall(r"(\w+)=(\S+)", image)}
        assert words["SKIN_BUS_DIR"] == str(self.folder)
        assert words["NUMBA_CACHE_DIR"].startswith(words["SKIN_CACHE"] + "/")  # one volume keeps both
        del words["PATH"], words["NUMBA_CACHE_DIR"], words["SKIN_CACHE"]  # use what is compiled and trained here
        return words

    def _word(self, word: str) -> str:
        word = re.sub(r"^tcp/(gateway|0\.0\.0\.0|127\.0\.0\.1):7447$", self.endpoint, word)
        word = re.sub(r"(?<!\d)8765(?!\d)", self.page_port, word)
        return word.replace("/run/canskin", str(self.folder)).replace("/var/cache/canskin", str(self.folder / "cache"))


@pytest.fixture(scope="module")
def outside(tmp_path_factory: pytest.TempPathFactory) -> Outside:
    return Outside(tmp_path_factory.mktemp("compose"), free_endpoint(), free_endpoint().rsplit(":", 1)[1])


@pytest.fixture(scope="module")
def running(services: dict[str, Service], outside: Outside) -> Iterator[Processes]:
    """Run the virtual profile's commands as written, with the image's environment."""
    with Processes(outside.folder, **outside.environment()) as processes:
        for name, service in of_profile(services, "virtual").items():
            processes.skin(name, *outside.words(service["command"]))
        yield processes


@pytest.mark.slow
def test_the_commands_as_written_give_measurements_images_and_health(
    services: dict[str, Service], outside: Outside, running: Processes
) -> None:
    measurements: list[Measurement] = []
    images: list[Image] = []
    fabric = Fabric("skin", "test", outside.endpoint)
    try:
        fabric.subscribe(MEASUREMENT, measurements.append)
        fabric.subscribe(IMAGE, images.append)
        running.until(lambda: any(min(each.valid) == 1 for each in measurements), "a complete measurement")
        running.until(lambda: any(min(each.valid) == 1 for each in images), "an image of a complete measurement")
        running.await_words("viewer", "web page")
        running.await_words("classifier", "knows")
    finally:
        fabric.close()
    assert np.frombuffer(images[0].pixels, "<f4").size == 64 * 64
    for name, service in of_profile(services, "virtual").items():
        assert is_healthy(service, outside), name
    running.stop("reconstructor")
    assert not is_healthy(services["reconstructor"], outside)


def is_healthy(service: Service, outside: Outside) -> bool:
    """Run a health check as written."""
    kind, *command = service["healthcheck"]["test"]
    assert kind == "CMD"
    return subprocess.run(outside.words(command), check=False, timeout=60).returncode == 0

"""``skin list``: skins, services, what they send, and services of another layout."""

import json
import threading
from contextlib import closing
from pathlib import Path
from typing import Any

import msgspec
import pytest

from canskin.errors import BusError, InputError
from canskin.fabric import Fabric
from canskin.keys import ENVIRONMENT, Keys
from canskin.messages import GATEWAY, IMAGE, MEASUREMENT
from canskin.session import open_hub
from health.list_command import list_
from shell.skin_options import join
from skin.layout import parse_layout
from tests.client.helpers import await_peers
from tests.hub.keys import make_authority
from tests.layouts import layout_toml
from tests.messages import gateway_status, image, measurement
from tests.processes import PATIENCE_S, free_port

PALM = parse_layout(layout_toml(16, 16, name="palm").encode(), "palm.toml")
SEED = msgspec.structs.replace(PALM, measurement=msgspec.structs.replace(PALM.measurement, seed=7))


def test_services_are_listed_with_what_they_send(
    endpoint: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("health.list_command", "shell.skin_options"):
        monkeypatch.setattr(f"{module}.PATIENCE_S", PATIENCE_S)
    stop = threading.Event()
    with (
        closing(join(PALM, "gateway", endpoint, hub=True)) as gateway,
        closing(join(SEED, "classifier", endpoint)),
        closing(join(PALM, "reconstructor", endpoint)) as reconstructor,
        closing(Fabric("hand", "recorder", endpoint)),
    ):

        def send() -> None:
            cycle = 0
            while not stop.wait(0.005):
                cycle += 1
                gateway.publish(GATEWAY, gateway_status(cycle))
                gateway.publish(MEASUREMENT, measurement(cycle))
                reconstructor.publish(IMAGE, image(cycle))

        sender = threading.Thread(target=send)
        sender.start()
        try:
            await_peers(gateway, "palm/classifier", "palm/reconstructor", "hand/recorder")
            by_name: dict[str, dict[str, Any]] = {}
            while not (by_name and by_name["gateway"]["rate_hz"] and by_name["reconstructor"]["rate_hz"]):
                list_(connect=endpoint, seconds=0.2, json=True)  # a slow machine may hear nothing in this time
                found = json.loads(capsys.readouterr().out)
                by_name = {each["service"]: each for each in found["services"]}
            list_(connect=endpoint, seconds=0.1)
        finally:
            stop.set()
            sender.join()
    table = capsys.readouterr().out
    assert found["skins"]["palm"]["layout"].startswith("16 x 16 taxels, 64 sums, synchronous, SYNC 100 Hz")
    assert found["skins"]["hand"] == {"error": "no gateway tells its layout"}
    assert by_name["gateway"]["state"].endswith("nodes operational")
    assert by_name["reconstructor"]["state"] == "sends"
    assert by_name["classifier"]["causes"] == ["service-differs"]
    assert "service-differs" not in by_name["reconstructor"]["causes"]
    assert {each["code"] for each in found["notices"]["palm"]} >= {"service-differs"}
    assert by_name["classifier"]["rate_hz"] == 0
    assert by_name["recorder"]["rate_hz"] is None
    assert by_name["gateway"]["fingerprint"] == PALM.phi().fingerprint != by_name["classifier"]["fingerprint"]
    assert [line.split()[:2] for line in table.splitlines()[3:]] == [
        ["hand", "recorder"],
        ["palm", "classifier"],
        ["palm", "gateway"],
        ["palm", "reconstructor"],
    ]


def test_a_gateway_that_hangs_is_told(
    endpoint: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("health.list_command.PATIENCE_S", PATIENCE_S)
    monkeypatch.setattr("shell.skin_options.PATIENCE_S", 0.2)
    with closing(Fabric("palm", "gateway", endpoint, hub=True, fingerprint=PALM.phi().fingerprint)):
        list_(connect=endpoint, seconds=0.1, json=True)
    (gateway,) = json.loads(capsys.readouterr().out)["services"]
    assert (gateway["state"], gateway["causes"]) == ("silent", ["gateway-silent"])


def test_a_hub_without_services_and_a_wrong_time_are_errors(
    endpoint: str, monkeypatch: pytest.MonkeyPatch, one_look: None
) -> None:
    with pytest.raises(InputError, match="--seconds needs a number above 0, up to 60"):
        list_(connect=endpoint, seconds=0)
    monkeypatch.setattr("health.list_command.PATIENCE_S", PATIENCE_S)
    with closing(Fabric("palm", "", endpoint, hub=True)), pytest.raises(BusError, match="no service at"):
        list_(connect=endpoint)


def test_what_the_keys_may_not_hear_has_no_rate_and_the_reason_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    authority, endpoint = (
        make_authority(tmp_path / "keys", "gateway", "nodes", "client"),
        f"tls/127.0.0.1:{free_port()}",
    )
    authority.issue("hand:gateway")
    with (
        closing(open_hub(endpoint, Keys(authority.keys_of("palm:hub")))),
        closing(Fabric("palm", "gateway", endpoint, fingerprint="1", keys=Keys(authority.keys_of("palm:gateway")))),
        closing(Fabric("palm", "nodes", endpoint, keys=Keys(authority.keys_of("palm:nodes")))),
        closing(Fabric("hand", "gateway", endpoint, keys=Keys(authority.keys_of("hand:gateway")))),
    ):
        monkeypatch.setenv(ENVIRONMENT, str(authority.keys_of("palm:client")))
        list_(connect=endpoint, seconds=0.1, json=True)
        found = json.loads(capsys.readouterr().out)
    rates = {(each["skin"], each["service"]): each["rate_hz"] for each in found["services"]}
    assert rates == {("palm", "gateway"): 0, ("palm", "nodes"): None, ("hand", "gateway"): None, ("palm", "hub"): None}
    assert "role 'client' may not ask 'layout'" in found["skins"]["palm"]["error"]

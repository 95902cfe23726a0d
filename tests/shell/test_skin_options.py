"""Where a verb's layout comes from: its options, the recording that it reads, or the services on a hub."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import msgspec
import pytest

from canskin import session
from canskin.errors import BusError, InputError, LayoutError
from canskin.fabric import Fabric
from shell import skin_options
from shell.skin_options import SkinOptions, join
from skin.layout import Layout, layout_text, load_layout, parse_layout
from tests.client.helpers import await_peers
from tests.layouts import layout_toml
from tests.processes import PATIENCE_S, Verb

PALM = parse_layout(layout_toml(16, 16, name="palm").encode(), "palm.toml")
OTHER = msgspec.structs.replace(PALM, sync=msgspec.structs.replace(PALM.sync, rate_hz=50.0))
HAND = msgspec.structs.replace(PALM, name="hand")


@pytest.fixture(autouse=True)
def much_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("PATIENCE_S", "GLANCE_S"):
        monkeypatch.setattr(skin_options, name, PATIENCE_S)


@contextmanager
def hub(endpoint: str, layout: Layout, service: str = "gateway") -> Iterator[Fabric]:
    with closing(join(layout, service, endpoint, hub=True)) as fabric:
        yield fabric


def written(layout: Layout, folder: Path) -> Path:
    path = folder / "given.toml"
    path.write_text(layout_text(layout))
    return path


@pytest.mark.parametrize("service", ["gateway", "replay"])
def test_a_gateway_and_a_replay_tell_the_layout(endpoint: str, service: str) -> None:
    with hub(endpoint, PALM, service):
        assert SkinOptions(connect=endpoint).find() == PALM
        assert SkinOptions(connect=endpoint, skin="palm").find() == PALM


def test_the_gateway_counts_where_services_have_different_layouts(endpoint: str) -> None:
    first = join(OTHER, "reconstructor", endpoint, hub=True)
    with closing(first), closing(join(OTHER, "viewer", endpoint)), closing(join(PALM, "gateway", endpoint)):
        await_peers(first, "palm/viewer", "palm/gateway")
        assert SkinOptions(connect=endpoint).find() == PALM


def test_several_skins_need_a_name(endpoint: str, one_look: None) -> None:
    with hub(endpoint, PALM) as first, closing(join(HAND, "gateway", endpoint)):
        await_peers(first, "hand/gateway")
        with pytest.raises(BusError, match=r"several skins at .*: 'hand', 'palm'; .* --skin NAME"):
            SkinOptions(connect=endpoint).find()
        assert SkinOptions(connect=endpoint, skin="hand").find() == HAND
        with pytest.raises(BusError, match=r"no skin 'foot' at .*, found 'hand', 'palm': start 'skin gateway'"):
            SkinOptions(connect=endpoint, skin="foot").find()


def test_who_waits_for_the_hub_is_named(endpoint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    monkeypatch.setattr(session, "tell", lambda *words: told.append(": ".join(words)))
    monkeypatch.setattr(session, "SILENT_S", 0.0)
    monkeypatch.setattr(skin_options, "PATIENCE_S", 0.6)
    with pytest.raises(BusError, match="no hub at"):
        SkinOptions(connect=endpoint).find("viewer")
    assert told == [f"viewer: waits for the fabric's hub at {endpoint}, usually 'skin gateway'"]


@pytest.mark.parametrize("service", ["reconstructor", "viewer"])
def test_a_hub_without_a_gateway_is_told_from_a_skin(endpoint: str, service: str, one_look: None) -> None:
    with (
        hub(endpoint, PALM, service),
        pytest.raises(BusError, match=rf"no skin at .*, found {service} of 'palm': start 'skin gateway', or"),
    ):
        SkinOptions(connect=endpoint).find()


def test_a_service_of_a_version_that_tells_no_layout_is_named(endpoint: str) -> None:
    with (
        closing(Fabric("palm", "gateway", endpoint, hub=True, fingerprint="12ab")),
        pytest.raises(BusError, match=r"gateway of skin 'palm', canskin .*, tells no layout at .*: give --layout FILE"),
    ):
        SkinOptions(connect=endpoint).find()


@pytest.mark.parametrize(
    "verb",
    [
        ["record", "run.mcap"],
        ["reconstruct"],
        ["classify"],
        ["view", "--port", "0"],
        ["show", "--foxglove", "run-foxglove.mcap"],
        ["ros2"],
        ["load"],
        ["tare"],
        ["calibration", "show"],
        ["calibration", "save", "it.json"],
    ],
    ids=" ".join,
)
def test_every_verb_that_connects_needs_no_layout_and_tells_one_error_without_a_hub(
    verb: list[str],
    endpoint: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    skin: Verb,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("shell.service.StopSignal.install", lambda self: self)
    monkeypatch.setattr(skin_options, "PATIENCE_S", 0.5)
    monkeypatch.setattr(skin_options, "SERVICE_PATIENCE_S", 0.6)
    code, _, told = skin(*verb, "--connect", endpoint)
    assert code == 2
    assert told == f"skin: no hub at {endpoint}: start 'skin gateway', or give another --connect\n"
    assert not list(tmp_path.iterdir())


def test_a_layout_that_differs_is_refused_with_what_differs(endpoint: str, tmp_path: Path) -> None:
    options = SkinOptions(layout=written(OTHER, tmp_path), connect=endpoint)
    with hub(endpoint, PALM):
        for refused in (lambda: options.join(options.find(), "viewer"), lambda: options.compare(options.find())):
            with pytest.raises(LayoutError, match=r"`\$.sync.rate_hz` is 50.0, there 100.0. Leave --layout out"):
                refused()
        same = SkinOptions(layout=written(PALM, tmp_path), connect=endpoint)
        same.join(same.find(), "viewer").close()


def test_a_skin_joins_a_hub_of_others_and_one_line_names_them(
    endpoint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []
    monkeypatch.setattr(skin_options, "tell", lambda *words: told.append(": ".join(words)))
    monkeypatch.setattr(skin_options, "PATIENCE_S", 0.0)
    options = SkinOptions(layout=written(HAND, tmp_path), connect=endpoint)
    with hub(endpoint, PALM):
        options.join(options.find(), "viewer").close()
    assert told == [f"skin: no service of 'hand' ({options.layout}) is at {endpoint} yet, found 'palm'"]


def test_a_hub_that_knows_no_skin_yet_is_joined(endpoint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options = SkinOptions(layout=written(PALM, tmp_path), connect=endpoint)
    with monkeypatch.context() as patch:
        patch.setattr(skin_options, "GLANCE_S", 0.1)
        options.compare(PALM)  # no hub is there
    with closing(Fabric("demo", "demo", endpoint, hub=True)), closing(options.join(PALM, "reconstructor")):
        pass


def test_two_names_are_refused() -> None:
    with pytest.raises(InputError, match="--skin palm: default is of skin 'skin': leave one of both out"):
        SkinOptions(layout=Path("default"), skin="palm").find()


def test_verbs_without_services_take_the_skin_of_a_hub_that_is_there_else_the_default_one(
    own_sockets: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = SkinOptions()
    assert options.find(needs_hub=False) == load_layout()
    monkeypatch.setattr(skin_options, "GLANCE_S", PATIENCE_S)
    with hub(options.endpoint, PALM):
        assert options.find(needs_hub=False) == PALM
        assert options.find(recording=Path("run.log"), needs_hub=False) == load_layout()
        assert SkinOptions(layout=Path("steps")).find(needs_hub=False) == load_layout(Path("steps"))
    with closing(Fabric("hand", "recorder", options.endpoint, hub=True)):
        monkeypatch.setattr(skin_options, "GLANCE_S", 0.1)
        assert options.find(needs_hub=False) == load_layout()

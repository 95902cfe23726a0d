"""What Prometheus is told of a skin, and by whom."""

import re
import socket
import threading
import time
import urllib.request
from contextlib import closing

import msgspec
import pytest
from prometheus_client import CollectorRegistry, generate_latest, make_wsgi_app

from canskin.description import LAYOUT, LayoutReply
from canskin.errors import InputError
from canskin.fabric import Fabric
from canskin.messages import GATEWAY, IMAGE, SILENT, ServiceStatus
from canskin.peers import Peer
from health.services import SERVICES, TOLD_S
from shell.command import build_app
from shell.service import listen
from skin.layout import layout_text
from tests.health.helpers import Messages
from tests.layouts import buses, small_layout
from tests.messages import service_status
from views.metrics import server
from views.metrics.command import EXPECTED
from views.metrics.exporter import Exporter
from views.metrics.server import serving
from views.metrics.skin_figures import CAUSES_MAX, SkinFigures


def status(processor_s: float, service: str = "reconstructor", instance: str = "reconstructor") -> ServiceStatus:
    return service_status(0, service, instance, processor_s=processor_s, missed=3)


def values(figures: SkinFigures, name: str, now_s: float = 0.0) -> dict[tuple[str, ...], float]:
    found = [(labels, value) for each, labels, value in figures.figures(now_s) if each == f"canskin_{name}"]
    assert len(dict(found)) == len(found)  # Prometheus refuses all if two are one
    return dict(found)


@pytest.fixture
def latencies_s() -> list[float]:
    return []


@pytest.fixture
def figures(messages: Messages, latencies_s: list[float]) -> SkinFigures:
    made = SkinFigures(messages.layout, EXPECTED, latencies_s.append)
    for name in ("exporter", "gateway", "reconstructor"):
        made.take_peer(Peer("palm", name, name), True, 0.0)
    return made


def test_a_healthy_skin(figures: SkinFigures, messages: Messages) -> None:
    figures.take(messages.gateway(cycles=40, missing=2), 0.0)
    figures.take(messages.image(invalid=(3,)), 0.0)
    assert values(figures, "up") == {("gateway",): 1, ("reconstructor",): 1}
    assert values(figures, "cause") == {}
    assert values(figures, "cycles_total") == values(figures, "cycles_complete_total") == {(): 40}
    fates = values(figures, "frames_total")
    assert (fates["accepted",], fates["missing",], fates["overrun",]) == (640, 2, 0)
    assert values(figures, "bus_load_ratio") == {("left",): 0.8, ("right",): 0.8}
    assert set(values(figures, "node_state").values()) == {5}
    assert set(values(figures, "node_state")) == {(bus, str(node)) for bus in ("left", "right") for node in range(1, 5)}
    assert values(figures, "blocks_valid_ratio") == {(): 7 / 8}


def test_what_is_gone_stays_and_what_is_not_known_is_left_out(figures: SkinFigures, messages: Messages) -> None:
    figures.take(messages.gateway(), 0.0)
    figures.take(messages.image(), 0.0)
    figures.take_peer(Peer("palm", "reconstructor", "reconstructor"), False, 1.0)
    figures.take_peer(Peer("palm", "gateway", "gateway"), False, 1.0)
    assert values(figures, "up", 9.0) == {("gateway",): 0, ("reconstructor",): 0}
    assert values(figures, "cycles_total", 9.0) == {(): 10}
    assert values(figures, "blocks_valid_ratio", 9.0) == {(): 0}
    assert values(figures, "bus_load_ratio", 9.0) == values(figures, "node_state", 9.0) == {}
    assert ("gateway-gone", "error", "gateway") in values(figures, "cause", 9.0)


def test_a_service_that_sends_nothing_and_a_hub_out_of_reach_are_not_up(
    figures: SkinFigures, messages: Messages
) -> None:
    for second in range(4):
        figures.take(messages.gateway(cycles=10_000), float(second))
    assert values(figures, "up", 3.0) == {("gateway",): 1, ("reconstructor",): 0}
    figures.take_peer(Peer("palm", "exporter", "exporter"), False, 4.0)
    assert values(figures, "up", 9.0) == {("gateway",): 0, ("reconstructor",): 0}
    assert set(values(figures, "cause", 9.0)) == {("hub-away", "error", "hub")}


def test_only_images_with_new_sums_have_a_latency(
    figures: SkinFigures, latencies_s: list[float], messages: Messages
) -> None:
    for sync_s, latency_s in ((1.0, 0.005), (1.0, 0.9), (2.0, 5.0), (3.0, -1.0)):
        figures.take(messages.image(sync_s=sync_s, latency_s=latency_s), sync_s)
    figures.take(msgspec.structs.replace(messages.image(sync_s=4.0), valid_sums=0), 4.0)
    assert latencies_s == pytest.approx([0.005, 5.0, 0.0])


def test_counters_of_a_service_go_on_over_its_starts(figures: SkinFigures) -> None:
    figures.take_peer(Peer("palm", "reconstructor", "2"), True, 0.0)
    for each in (status(5.0), status(7.0), status(1.0, instance="2"), status(8.0), status(2.0, instance="2")):
        figures.take(each, 1.0)
    assert values(figures, "service_processor_seconds_total", 1.0) == {("reconstructor",): 10.0}
    assert values(figures, "messages_missed_total", 1.0) == {("reconstructor",): 6}
    assert values(figures, "service_memory_bytes", 1.0) == {("reconstructor",): 2 << 20}
    assert values(figures, "service_memory_bytes", 1.0 + TOLD_S) == {}
    figures.take(status(7.5), 2.0)
    figures.take(status(float("nan")), 2.0)
    figures.take(status(float("inf")), 2.0)
    assert values(figures, "service_processor_seconds_total", 2.0) == {("reconstructor",): 10.0}


def test_strangers_make_no_more_than_a_few_series(figures: SkinFigures, messages: Messages) -> None:
    for number in range(3 * SERVICES):
        figures.take_peer(Peer("palm", f"s{number}", f"{number}"), True, 0.0)
        figures.take(status(1.0, f"s{number}", f"{number}"), 0.0)
    assert 0 < len(values(figures, "service_overruns_total")) <= SERVICES
    known = messages.gateway()
    bus = msgspec.structs.replace(known.buses[0], nodes=list(range(999)), nmt=bytes([SILENT] * 999))
    strangers = [msgspec.structs.replace(bus, name=f"bus{number}", trouble=f"t{number}") for number in range(500)]
    figures.take(msgspec.structs.replace(known, buses=[bus, *strangers]), 0.0)
    assert set(values(figures, "bus_load_ratio")) == {("left",)}
    assert len(values(figures, "node_state")) == 127
    assert len(values(figures, "cause")) <= CAUSES_MAX


def scraped(port: int) -> str:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=60) as answer:
        return str(answer.read().decode())


def await_text(port: int, pattern: str) -> str:
    give_up_s = time.monotonic() + 60
    while not re.search(pattern, text := scraped(port), re.MULTILINE):
        assert time.monotonic() < give_up_s, text
        time.sleep(0.05)
    return text


def gateway(messages: Messages, endpoint: str, *, hub: bool = False) -> Fabric:
    """Return the connection of a gateway that tells its layout."""
    layout = messages.layout
    told = LayoutReply(layout_text(layout))

    def prepare(fabric: Fabric) -> None:
        fabric.answer(LAYOUT, lambda _request, reply: reply(told))

    phi = layout.operator().fingerprint
    return Fabric(layout.name, "gateway", endpoint, hub=hub, fingerprint=phi, prepare=prepare)


@pytest.mark.heavy
def test_one_exporter_shows_all_skins_of_a_hub(endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    palm, back = Messages(), Messages(small_layout(16, 16, name="back", bus=buses(4, 4, names=("left", "right"))))
    exporter, registry, stop = Exporter(endpoint, EXPECTED), CollectorRegistry(), threading.Event()
    registry.register(exporter)
    running = threading.Thread(target=exporter.run, args=(stop,))
    with listen("127.0.0.1", 0) as listener, serving(listener, make_wsgi_app(registry)):
        port = listener.getsockname()[1]
        assert "canskin_up{" not in scraped(port)
        running.start()
        with closing(gateway(palm, endpoint, hub=True)) as first, closing(gateway(back, endpoint)) as second:
            for name in ("palm", "back"):
                await_text(port, rf'canskin_up{{service="gateway",skin="{name}"}} 1.0')
            first.publish(GATEWAY, palm.gateway(cycles=10))
            first.publish(IMAGE, palm.image())
            second.publish(GATEWAY, back.gateway(cycles=20))
            await_text(port, r'canskin_cycles_total{skin="palm"} 10.0')
            await_text(port, r'canskin_cycles_total{skin="back"} 20.0')
            text = await_text(port, r'seconds_bucket{le="0.005",skin="palm"} 1.0')
            assert 'canskin_sync_to_image_seconds_bucket{le="+Inf",skin="back"} 0.0' in text
            second.close()
            await_text(port, r'canskin_up{service="gateway",skin="back"} 0.0')
        text = await_text(port, r'canskin_up{service="gateway",skin="palm"} 0.0')
        await_text(port, r'canskin_cause{code="hub-away",level="error",skin="palm",subject="hub"} 1.0')
        assert "skin 'palm': nothing arrives: hub [hub-away]" in capsys.readouterr().err
        assert 'canskin_cycles_total{skin="palm"} 10.0' in text
        stop.set()
        running.join()
        exporter.close()


def test_silent_connections_leave_a_place_when_they_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "REQUESTS_MAX", 2)
    registry = CollectorRegistry()
    with listen("127.0.0.1", 0) as listener, serving(listener, make_wsgi_app(registry)):
        address = listener.getsockname()
        first, second, third = (socket.create_connection(address) for _ in range(3))
        with first, second, third:
            assert third.recv(1) == b""
        give_up_s = time.monotonic() + 60
        while time.monotonic() < give_up_s:
            try:
                assert scraped(address[1]) == generate_latest(registry).decode()
                break
            except OSError:
                time.sleep(0.01)
        else:
            pytest.fail("no place became free")


@pytest.mark.parametrize("host", ["0.0.0.0", "10.0.0.5", "::"])  # noqa: S104 - refused
def test_a_network_may_read_the_figures_only_if_the_user_says_so(host: str) -> None:
    with pytest.raises(InputError, match="could read the figures: expected an address of loopback, or --insecure"):
        build_app(["metrics"]).meta(["metrics", "--host", host])

"""``skin metrics``: the figures of all skins of a hub, for Prometheus."""

from contextlib import closing
from typing import Final

from canskin.session import DEFAULT_ENDPOINT
from shell.extras import not_installed
from shell.pulse import Pulse
from shell.service import StopSignal, listen, say
from shell.skin_options import Insecure, check_host

#: Beside those of ``skin view`` and ``skin show --foxglove``.
PORT: Final = 8767
#: Services without which a skin has no images.
EXPECTED: Final = ("gateway", "reconstructor")


def metrics(
    *,
    connect: str = DEFAULT_ENDPOINT,
    host: str = "127.0.0.1",
    port: int = PORT,
    insecure: Insecure = False,
    expect: tuple[str, ...] = EXPECTED,
) -> None:
    """Serve the figures of all skins of a hub to Prometheus: services, buses, boards, latencies, what is wrong.

    Alert rules are in deploy/prometheus, a dashboard for Grafana is in deploy/grafana. Needs the extra
    canskin[metrics].

    Parameters
    ----------
    connect
        Endpoint of the fabric's hub.
    host
        Address to listen on.
    port
        Port to listen on; 0 takes a free port and prints it.
    insecure
        Listen on a network: everybody there can read the figures.
    expect
        Services that each skin has to have: their absence is an alert.

    Examples
    --------
    skin metrics
    skin metrics --host 0.0.0.0 --insecure --expect gateway reconstructor classifier recorder
    """
    try:
        from prometheus_client import CollectorRegistry, ProcessCollector, make_wsgi_app

        from views.metrics.exporter import Exporter
        from views.metrics.server import serving
    except ImportError as error:
        raise not_installed("skin metrics needs prometheus_client", "metrics") from error
    from views.metrics.skin_figures import SERVICE

    check_host(f"--host {host}", host, "read the figures", insecure=insecure)
    pulse = Pulse(StopSignal().install())
    exporter, registry = Exporter(connect, expect), CollectorRegistry()
    registry.register(exporter)
    ProcessCollector(registry=registry)
    with listen(host, port) as listener, closing(exporter), serving(listener, make_wsgi_app(registry)):
        address, used_port = listener.getsockname()[:2]
        say(SERVICE, f"figures at http://{f'[{address}]' if ':' in address else address}:{used_port}/metrics")
        exporter.run(pulse)

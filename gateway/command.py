"""``skin gateway``: bus master and collector."""

from pathlib import Path

from bus.options import BusOptions, open_links
from dbc.contract import Contract
from gateway.service import GatewayService
from skin.fabric import DEFAULT_ENDPOINT, Fabric
from skin.layout import load_layout
from skin.service import StopSignal, say


def gateway(
    *,
    layout: Path | None = None,
    bus: BusOptions | None = None,
    listen: str = DEFAULT_ENDPOINT,
    connect: str | None = None,
) -> None:
    """Boot the nodes, produce SYNC, and publish the sums: those of each cycle, or the newest of adaptive nodes.

    Parameters
    ----------
    layout
        TOML of the skin; without it the default skin.
    bus
        CAN interface and channels.
    listen
        Endpoint of the fabric's hub, which the gateway runs; the other services connect to this endpoint.
    connect
        Endpoint of another hub; the gateway then runs none.

    Examples
    --------
    skin gateway
    skin gateway --layout adaptive
    skin gateway -i socketcan -c can0 --layout palm.toml
    """
    stop = StopSignal().install()
    skin = load_layout(layout, adaptive=True)
    links = open_links(skin, bus or BusOptions(), name="gateway", stop=stop)
    contract = Contract.from_layout(skin)
    hub, mark = connect or listen, contract.phi.fingerprint
    fabric = Fabric(skin.name, "gateway", hub, hub=connect is None, stop=stop, fingerprint=mark)
    say("gateway", f"{len(links)} bus{'es' * (len(links) != 1)}, SYNC {skin.sync.rate_hz:g} Hz")
    try:
        GatewayService(contract, links, fabric).run(stop)
    finally:
        for link in links.values():
            link.close()
        fabric.close()

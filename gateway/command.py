"""``skin gateway``: bus master and collector."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from bus.options import BusOptions, closing_links, open_links
from calibration.calibrator import Tare
from calibration.keeping import kept_zero
from canskin.calibration_messages import CALIBRATION, ZERO
from canskin.fabric import Fabric
from canskin.keys import environment_keys
from canskin.session import DEFAULT_ENDPOINT, checked
from dbc.contract import Contract
from gateway.calibration import GatewayCalibration
from gateway.duty import Duties
from gateway.service import GatewayService
from gateway.stepped_gathering import publishing_rates
from shell.output import check_output_path
from shell.pulse import Pulse
from shell.service import RateLimitedLog, StopSignal, say
from shell.skin_options import Insecure, check_listen, join
from skin.calibration_file import load_calibration
from skin.layout import load_layout, require_sending


def gateway(
    *,
    layout: Path | None = None,
    bus: BusOptions | None = None,
    listen: str = DEFAULT_ENDPOINT,
    connect: str | None = None,
    insecure: Insecure = False,
    max_rate: float | None = None,
    min_rate: float | None = None,
    calibration: Path | None = None,
    tare: Tare = "at-start",
    keep_zero: Path | None = None,
) -> None:
    """Boot the nodes, produce SYNC, and publish the sums: those of each cycle, or the newest of stepped nodes.

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
    insecure
        The hub may serve a network without keys: everybody there can read the skin, tare it and send false images.
    max_rate
        Of steps: most measurements in a second, when there is news; 1 to 1000 Hz, by default 250.
    min_rate
        Of steps: measurements in a second without news; 1 Hz to `max_rate`, by default 10.
    calibration
        File of ``skin calibration save``: the offsets that are used until the zero is measured.
    tare
        ``at-start``: measure the offsets of the sums as soon as the skin has been untouched for 2 s or
        64 cycles, and follow them;
        ``never``: those of ``--calibration`` stay as they are, no force is doubted, and no defects are found.
        Stepped boards measure their own.
    keep_zero
        File (.json) for the zero: the gateway begins with the zero of its last run, and writes its zero once a
        minute and at the end.

    Examples
    --------
    skin gateway
    skin gateway --layout steps --max-rate 1000
    skin gateway -i socketcan -c can0 --layout palm.toml
    skin gateway --calibration palm.json --tare never
    skin gateway --keep-zero /var/lib/canskin/palm.json
    """
    stop = StopSignal().install()
    pulse = Pulse(stop)
    if connect is None:
        check_listen(listen, insecure=insecure)
    checked(connect or listen, environment_keys())  # the buses come first, and may be waited for
    skin = load_layout(layout)
    rates_hz = publishing_rates(max_rate, min_rate)
    if (max_rate, min_rate) != (None, None):
        require_sending(skin, "steps", "--max-rate and --min-rate are", "this layout has a measurement per cycle")
    contract = Contract.from_layout(skin)
    if (calibration or keep_zero) is not None:
        option = "--calibration" if calibration is not None else "--keep-zero"
        require_sending(skin, "synchronous", f"{option} is", "stepped boards measure their own offsets")
    if keep_zero is not None:
        check_output_path(keep_zero, "zero", ".json")
    stored = None if calibration is None else load_calibration(calibration, skin)
    if stored is not None:
        stored.required_offsets_n(str(calibration))
    if keep_zero is not None:
        stored = kept_zero(keep_zero, skin, stored)
    links = open_links(skin, bus or BusOptions(), name="gateway", stop=stop)
    answers = ThreadPoolExecutor(1, "calibration")
    calibrates = GatewayCalibration(contract, stored, tares=tare == "at-start", submit=answers.submit, keeps=keep_zero)
    services: list[GatewayService] = []

    def prepare(fabric: Fabric) -> None:  # loads kernels, too: before the others see the gateway
        duties = Duties(fabric, skin.name, skin.operator().fingerprint, RateLimitedLog("gateway").say)
        services.append(
            GatewayService(contract, links, fabric, calibration=calibrates, rates_hz=rates_hz, duties=duties)
        )
        for question in (CALIBRATION, ZERO):
            fabric.answer(question, calibrates.ask)

    fabric = join(skin, "gateway", connect or listen, hub=connect is None, stop=pulse, prepare=prepare)
    pulse.fabric = fabric
    say("gateway", f"{len(links)} bus{'es' * (len(links) != 1)}, SYNC {skin.sync.rate_hz:g} Hz")
    try:
        with closing_links(links):
            services[0].run(stop, pulse.beat)
    finally:
        calibrates.keep_zero()
        answers.shutdown()
        fabric.close()

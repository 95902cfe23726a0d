"""What can be wrong with a skin: one table for the page, ``skin doctor``, ``skin list``, ROS 2, logs and metrics."""

from enum import Enum
from typing import Final

from health.snapshot import Notice

ERROR: Final = "error"
WARNING: Final = "warning"
INFO: Final = "info"
#: Levels, worst first.
GRAVE: Final = (ERROR, WARNING, INFO)

_RESTART: Final = "start it again; its log says why it ended"
_WIRING: Final = "check plugs, the supply, and the terminating resistors of {subject}"


class Cause(Enum):
    """A cause of trouble: its level, what a user sees of it, and what to do.

    ``{subject}`` in what to do is what the notice is about.

    Attributes
    ----------
    level : str
        `ERROR`: measurements, images or labels stop; `WARNING`: they are degraded; `INFO`: a start is not finished.
    sees, mend : str
    """

    # Services
    HUB_AWAY = (ERROR, "nothing arrives", "start 'skin gateway' or 'skin hub', or give the right --connect")
    GATEWAY_ABSENT = (INFO, "no gateway was there since the start", "start 'skin gateway'")
    GATEWAY_GONE = (ERROR, "measurements stop", _RESTART)
    GATEWAY_SILENT = (ERROR, "the state of the buses is unknown", "restart the gateway: it runs and sends nothing")
    OTHER_SKIN = (WARNING, "the hub has other skins alone", "give all services of a skin the same --layout")
    STARTING = (INFO, "SYNC has not started", "wait: the gateway proves its nodes")
    SERVICE_GONE = (ERROR, "images, labels or sums of simulated boards stop", _RESTART)
    SERVICE_ABSENT = (WARNING, "images or labels were never there", "start the service; its log says why it ended")
    SERVICE_SILENT = (ERROR, "images or labels stop", "restart the service: it has input and sends nothing")
    SERVICE_DIFFERS = (ERROR, "a service has another Φ or version", "give it the same --layout and version of canskin")
    SERVICE_DROPS = (WARNING, "a service misses messages", "give its host more processor time: 'skin doctor time'")
    CLOCK_UNSURE = (
        INFO,
        "times of a service on another machine are not exact",
        "use a wire in place of radio between the machines; let PTP (ptp4l) or NTP (chronyd) have set both clocks",
    )
    NO_IMAGE = (INFO, "no image yet", "wait, or start 'skin reconstruct'")
    MISFITS = (WARNING, "messages do not fit the skin", "give all services the same --layout")
    RECORDING_ENDED = (ERROR, "the recording has ended", "free the disk, and start it again")
    # Buses
    INTERFACE_DIFFERS = (ERROR, "a bus has another bit rate, or its interface is set otherwise", "'skin plan --timing'")
    INTERFACE_LOST = (ERROR, "a bus is dead: its interface is gone", "plug the adapter in, and set the interface up")
    BUS_OFF = (ERROR, "a bus is dead: the controller is bus-off", _WIRING + "; compare bit rates: 'skin doctor'")
    ERROR_PASSIVE = (WARNING, "no node acknowledges frames", _WIRING + "; compare bit rates: 'skin doctor'")
    SYNC_REFUSED = (WARNING, "SYNC is not sent on a bus", "free the bus or the host: 'skin load', 'skin doctor time'")
    OTHER_SYNC = (
        ERROR,
        "blocks are not valid: SYNC has two producers",
        "stop the second gateway, or clear bit 30 of 1005h of the device that 'skin scan' names",
    )
    BUS_ERRORS = (WARNING, "frames are destroyed on a bus", _WIRING + "; compare bit rates")
    BUS_LOAD_ABOVE_PLAN = (WARNING, "a bus carries more than its plan", "'skin load --check' tells what is not planned")
    BUS_FULL = (WARNING, "frames come late or not at all", "'skin load' tells who fills the bus")
    CABLE_BREAK = (ERROR, "all boards behind a place are silent", "check the cable and the plug at {subject}")
    NOTHING_MEASURED = (ERROR, "no block sends sums", "start the boards; 'skin scan' tells what is there")
    # Nodes
    NODE_ABSENT = (
        WARNING,
        "a board was never heard",
        "power and plug it; 'skin scan' tells another node-ID",
    )
    NODE_AWAY = (INFO, "an optional board is not there", "plug the board in if it is wanted")
    NODE_SILENT = (WARNING, "a board is silent", "check its supply and plug")
    NODE_OTHER_DEVICE = (
        WARNING,
        "another device has the board's node-ID",
        "'skin scan' names it",
    )
    NODE_TWICE = (WARNING, "two boards have one node-ID", "unplug one: 'skin commission' gives it another")
    NODE_REFUSED = (
        WARNING,
        "a board's configuration is refused",
        "compare its program with the layout: stop the gateway, then 'skin node check --node ID'",
    )
    NODE_UNANSWERED = (WARNING, "a board answers no SDO request", "reset the board; another master may use its SDO")
    NODE_LEFT = (WARNING, "a board has left OPERATIONAL", "its emergency says why; the gateway starts it again")
    NODE_BOOTED = (WARNING, "a board has booted again", "check its supply if that repeats")
    NODE_CHANGED = (WARNING, "somebody else writes a board's configuration", "stop the other master, or its writes")
    NODE_UNPROVEN = (WARNING, "a board's configuration was not proven in time", "lower the load of the bus")
    NODE_STARTING = (INFO, "a board is proven before its start", "wait")
    NODE_FROZEN = (WARNING, "a board's sums never change", "reset the board; its converters have stopped")
    NODE_LATE = (WARNING, "a board answers late", "lower the load of the bus, or of the board")
    NODE_LOSES = (WARNING, "frames with sums are missing", "'skin load' and 'skin doctor time' tell what is busy")
    NODE_EMERGENCY = (WARNING, "a board reports an error", "the code says which: CiA 301, 7.2.7.1")
    # Calibration
    NO_ZERO = (INFO, "forces are not above a zero that was measured", "leave the skin untouched, or 'skin tare'")
    GAINS_CHANGED = (WARNING, "forces of boards are doubtful", "'skin tare' accepts the new gains and offsets")
    DEFECT = (WARNING, "taxels are broken", "'skin calibration show'")
    DOUBTFUL_FORCE = (WARNING, "a force may be an error of the zero", "'skin tare --region' if nothing touches there")
    THRESHOLD = (WARNING, "a force is above its threshold", "take the force away")
    # Hosts
    HOST_LATE = (WARNING, "SYNCs are left out, or frames are lost at the gateway", "'skin doctor time'")
    HOST_SETTING = (INFO, "a setting of the host is not best for a skin", "'skin doctor time'")

    def __init__(self, level: str, sees: str, mend: str) -> None:
        self.level, self.sees, self.mend = level, sees, mend

    @classmethod
    def of(cls, code: str) -> "Cause":
        """Return the cause with a code."""
        return cls[code.upper().replace("-", "_")]

    @property
    def code(self) -> str:
        """The name of the cause in notices, JSON and metrics, for example ``node-silent``."""
        return self.name.lower().replace("_", "-")

    def notice(
        self, text: str, subject: str = "", since_time_s: float | None = None, level: str = "", mend: str = ""
    ) -> Notice:
        """Return a notice of this cause; `text` says what is seen, and of what, with its evidence."""
        return Notice(
            level=level or self.level,
            code=self.code,
            subject=subject,
            text=text,
            mend=mend or self.mend.format(subject=subject),
            since_time_s=since_time_s,
        )

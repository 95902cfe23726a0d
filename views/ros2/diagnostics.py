"""The state of a skin as ``diagnostic_msgs/msg/DiagnosticArray``: one status of the skin, one of each bus."""

from collections.abc import Iterator
from typing import Any, Final

from canskin.messages import NmtState
from health.snapshot import BusView, Snapshot
from views.ros2.types import DIAGNOSTICS, message

OK: Final = 0
WARN: Final = 1
ERROR: Final = 2
STALE: Final = 3
_LEVELS: Final = {"info": OK, "warning": WARN, "error": ERROR}


def diagnostics(head: Any, state: Snapshot) -> Any:
    """Return the state of a skin. The notices are those of the web page."""
    return message(DIAGNOSTICS, header=head, status=list(_statuses(state)))


def key(head: Any, skin: str, of: str, values: dict[str, Any]) -> Any:
    """Return stamped values that join a message with tables of ``skin export``; `of` names what they belong to."""
    return message(DIAGNOSTICS, header=head, status=[_status(OK, of, "", skin, values)])


def _statuses(state: Snapshot) -> Iterator[Any]:
    figures, label, gateway = state.figures, state.label, state.gateway
    calibration = gateway.calibration if gateway else None
    level = max((_LEVELS[notice.level] for notice in state.notices), default=OK)
    values: dict[str, Any] = {
        "images per second": f"{figures.images_hz:.1f}",
        "latency median s": figures.latency_p50_s,
        "latency 99th percentile s": figures.latency_p99_s,
        "valid blocks": figures.valid_blocks,
        "blocks": figures.blocks,
        "label": label.label if label and label.measured and not label.stale else None,
        "label confidence": label.confidence if label and not label.stale else None,
        "cycles": gateway.cycles if gateway else None,
        "complete cycles": gateway.cycles_complete if gateway else None,
        "calibration": calibration.state.value if calibration else None,
        "zero of the blocks": (calibration.zero_words or None) if calibration else None,
        "oldest zero s": calibration.oldest_zero_s if calibration else None,
        "doubtful taxels": calibration.doubtful_taxels if calibration else None,
        "doubtful force N": calibration.doubtful_force_n if calibration else None,
        **{f"cause {number}": f"{each.code}: {each.text}; {each.mend}" for number, each in enumerate(state.notices, 1)},
    }
    words = state.notices[0].text if state.notices else "measures"
    yield _status(level, f"canskin: {state.skin}", words, state.skin, values)
    for bus in gateway.buses if gateway else []:
        yield _bus(state, bus, is_stale=gateway is None or gateway.stale)


def _bus(state: Snapshot, bus: BusView, *, is_stale: bool) -> Any:
    off_duty = [node for node, nmt in zip(bus.nodes, bus.nmt, strict=True) if nmt != NmtState.OPERATIONAL]
    level, words = _LEVELS[bus.level], "all nodes operational"
    if is_stale:
        level, words = STALE, "the gateway sends no status"
    elif bus.dead:
        words = bus.trouble or f"the gateway's controller is {bus.link}"
    elif bus.trouble:
        words = bus.trouble
    elif off_duty:
        words = f"{len(off_duty)} of {len(bus.nodes)} nodes not operational"
    values = {
        "load": f"{bus.load_ratio:.3f}",
        "controller": bus.link,
        "nodes": len(bus.nodes),
        "nodes not operational": " ".join(map(str, off_duty)),
        "nodes refused": " ".join(map(str, bus.refused)),
        "frames missing": sum(bus.missing),
        "frames late": sum(bus.late),
        "frames lost by the gateway": bus.overrun,
    }
    return _status(level, f"canskin: {state.skin} {bus.name}", words, f"{state.skin} {bus.name}", values)


def _status(level: int, name: str, words: str, hardware: str, values: dict[str, Any]) -> Any:
    pairs = [
        message("diagnostic_msgs/msg/KeyValue", key=key, value="unknown" if value is None else str(value))
        for key, value in values.items()
    ]
    return message(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=level,
        name=name,
        message=words,
        hardware_id=hardware,
        values=pairs,
    )

"""``skin tare`` and ``skin calibration``: what a running gateway takes for zero."""

from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec
from cyclopts import Parameter

from calibration.gain_files import stored_gains
from canskin.calibration_messages import (
    ANSWER_S,
    CALIBRATION,
    ZERO,
    CalibrationReply,
    CalibrationRequest,
    CalibrationState,
    CalibrationStatus,
    ZeroRequest,
    tare_request,
)
from canskin.errors import InputError, RunError
from canskin.question import Question
from shell.output import check_output_path, write_file
from shell.service import say
from shell.skin_options import PATIENCE_S, SkinOptions
from shell.terminal import Json, print_json, print_table
from skin.calibration_file import (
    StoredCalibration,
    encoded,
    load_calibration,
    most_offset_n,
    parse_calibration,
)
from skin.layout import Layout, require_boards
from skin.limits import read_file
from skin.regions import taxels_of

#: Longest wait for the answer to ``write``: writing to nodes takes up to a minute.
WRITING_S: Final = 300.0

Action = Literal["show", "save", "load", "gain"]


def tare(
    *,
    of: SkinOptions | None = None,
    force: Annotated[bool, Parameter(negative=())] = False,
    region: str | None = None,
    json: Json = False,
) -> int:
    """Have a running gateway measure the zero of its skin anew; nothing may touch the skin for 2 s, or 64 cycles.

    Ends with 1 if there is no new zero, because something touches the skin or moves on it.

    Parameters
    ----------
    of
        Which skin.
    force
        Whatever touches the skin now becomes part of its zero.
    region
        First row, first column, last row, last column, from 0, or the name of a region: whatever stands there now
        becomes part of its zero, and the rest of the skin keeps its zero. The page names the region of a doubtful
        contact. A skin of positions has one row, row 0, and the numbers of its taxels are columns.
    json
        Print one JSON object.

    Examples
    --------
    skin tare
    skin tare --force
    skin tare --region 12,20,19,31
    skin tare --region thumb
    """
    of = of or SkinOptions()
    of.require_right("ask", CALIBRATION.name)
    skin = of.find("tare")
    require_boards(skin)
    named = region if region is None or region[:1].isalpha() else region.split(",")
    request = tare_request(skin.taxels.rows, skin.taxels.columns, force=force, region=named)
    if request.region is not None:
        taxels_of(skin, request.region)
    reply = _ask(skin, of, CALIBRATION, request, ANSWER_S)
    if json:
        print_json({"is_done": reply.is_done, "text": reply.text, "status": msgspec.to_builtins(reply.status)})
    else:
        print(reply.text)
    return int(not reply.is_done)


def calibration(
    action: Action,
    path: Path | None = None,
    *,
    of: SkinOptions | None = None,
    to_nodes: Annotated[bool, Parameter(negative=())] = False,
    force_n: float | None = None,
    before: Path | None = None,
    out: Path | None = None,
    json: Json = False,
) -> None:
    """Show, save or load the calibration of a running gateway; find the gains of taxels and of analogue sums.

    Parameters
    ----------
    action
        ``show`` a file's calibration, or without a file the gateway's; ``save`` the gateway's into a file; ``load`` a
        file into the gateway; ``gain`` finds the gains of the taxels.
    path
        File (.json). It belongs to its layout: other layouts refuse it. Of ``gain``: a recording (.mcap) of a round
        weight that was rolled over a tared skin, or a .csv with the gains, one row of taxels a line.
    of
        Which skin. A recording has its layout in itself; any other file of ``show`` and ``gain`` is of the default skin
        without an option.
    to_nodes
        Of ``load``: write gains (2010h) and offsets of taxels (2011h) to all nodes, which store them (1010h).
    force_n
        Of ``gain``: the force of the weight, newtons.
    before
        Of ``gain``: calibration with the gains that the nodes took off during the roll; default: those in the
        recording. The gains that are found multiply them.
    out
        Of ``gain``: the file (.json) for the gains.
    json
        Print one JSON object.

    Examples
    --------
    skin calibration show
    skin calibration save palm.json
    skin calibration gain rolled.mcap --force-n 0.4 --out gains.json
    skin calibration load gains.json --to-nodes
    """
    of = of or SkinOptions()
    if action != "show" and path is None:
        raise InputError(f"expected a file: skin calibration {action} FILE")
    if to_nodes and action != "load":
        raise InputError("--to-nodes is for 'skin calibration load'")
    if action != "gain" and (force_n, before, out) != (None, None, None):
        raise InputError("--force-n, --before and --out are for 'skin calibration gain'")
    _check_written(action, path, out)
    if action == "load" and path is not None:
        read_file(path, InputError, "the calibration")  # before any wait for a hub
    reads = path if action in {"show", "gain"} else None
    skin = of.find(recording=reads, needs_hub=reads is None)
    require_boards(skin)
    if path is None or action == "show":
        _show(skin, of, path, as_json=json)
    elif out is not None:
        _save(skin, out, stored_gains(skin, path, force_n, before))
    elif action == "save":
        stored, status = _gateways(skin, of)
        if not stored.offsets_n and not stored.gains:
            is_off = status is not None and status.state is CalibrationState.OFF
            why = "and measures none: start it with --tare at-start." if is_off else "yet: is the skin untouched?"
            raise RunError(f"the gateway has no calibration {why} See 'skin calibration show'")
        _save(skin, path, stored)
    else:
        content = encoded(load_calibration(path, skin))
        request = CalibrationRequest(action="write" if to_nodes else "load", content=content)
        reply = _ask(skin, of, CALIBRATION, request, WRITING_S if to_nodes else ANSWER_S)
        if not reply.is_done:
            raise RunError(reply.text)
        say("calibration", reply.text)


def _check_written(action: Action, path: Path | None, out: Path | None) -> None:
    if action == "gain" and out is None:
        raise InputError("expected a file for the gains: --out FILE")
    written = {"gain": out, "save": path}.get(action)
    if written is not None:
        check_output_path(written, "calibration", ".json")


def _gateways(skin: Layout, of: SkinOptions) -> tuple[StoredCalibration, CalibrationStatus | None]:
    """Return the calibration of the gateway, and its status."""
    reply = _ask(skin, of, ZERO, ZeroRequest(), ANSWER_S)
    return parse_calibration(reply.content, skin, "the gateway", is_shown=True), reply.status


def _save(skin: Layout, path: Path, stored: StoredCalibration) -> None:
    write_file(path, encoded(stored))
    say("calibration", ": ".join(filter(None, (str(path), _words(stored), _beyond(skin, stored)))))


def _beyond(skin: Layout, stored: StoredCalibration) -> str:
    """Say how many offsets the skin cannot have; empty if it can have all."""
    most_n = most_offset_n(skin)
    places = [place for place, each in enumerate(stored.offsets_n) if each is not None and abs(each) > most_n]
    if not places:
        return ""
    return f"{len(places)} offsets beyond ±{1e3 * most_n:g} mN, first of sum {places[0]}: no gateway loads them"


def _ask(
    skin: Layout, of: SkinOptions, question: Question, request: CalibrationRequest | ZeroRequest, timeout_s: float
) -> CalibrationReply:
    fabric = of.join(skin, "calibration", patience_s=PATIENCE_S)
    try:
        reply: CalibrationReply = fabric.ask(question, request, timeout_s)
    finally:
        fabric.close()
    return reply


def _words(stored: StoredCalibration) -> str:
    known = [each for each in stored.offsets_n if each is not None]
    parts = [f"offsets of {len(known)} of {len(stored.offsets_n)} sums"] if known else []
    parts += [f"gains of {len(stored.gains)} taxels"] if stored.gains else []
    parts += [f"gains of {len(stored.differential_gains)} sums"] if stored.differential_gains else []
    return ", ".join(parts) or "nothing"


def _show(skin: Layout, of: SkinOptions, path: Path | None, *, as_json: bool) -> None:
    """Print the calibration of a file, or of the gateway."""
    status = None
    if path is None:
        stored, status = _gateways(skin, of)
    else:
        stored = load_calibration(path, skin, is_shown=True)
    if as_json:
        print_json({"calibration": msgspec.to_builtins(stored), "status": msgspec.to_builtins(status)})
        return
    rows: list[tuple[str, str]] = [("skin", f"{stored.skin}, Φ {stored.fingerprint}"), ("saved", stored.saved)]
    known = [each for each in stored.offsets_n if each is not None]
    if known:
        rms_n = (sum(each * each for each in known) / len(known)) ** 0.5
        rows += [
            ("sums with an offset", f"{len(known)} of {len(stored.offsets_n)}"),
            ("offsets", f"{1e3 * rms_n:.2f} mN rms, {1e3 * min(known):.2f} to {1e3 * max(known):.2f} mN"),
        ]
    if beyond := _beyond(skin, stored):
        rows.append(("out of range", beyond))
    if stored.gains:
        rows.append(("gains of taxels", f"{min(stored.gains):.3f} to {max(stored.gains):.3f}"))
    if stored.differential_gains:
        both = (stored.differential_gains, stored.common_mode_gains)
        ranges = [f"{min(each):.3f} to {max(each):.3f}" for each in both]
        rows.append(("gains of sums", f"differential {ranges[0]}, common mode {ranges[1]}"))
    if status is not None:
        rows += [
            ("zero", status.state.value),
            ("drift", f"{1e3 * status.drift_rms_n_per_s:.3f} mN/s rms"),
            ("noise of a sum", f"{1e3 * status.noise_n:.2f} mN"),
            ("blocks under a touch", str(status.held_blocks)),
            *([("zero of the blocks", status.zero_words)] if status.zero_words else []),
            ("doubtful taxels", status.doubtful_words or "none"),
        ]
    rows += [("defect", text) for text in stored.defects]
    print_table((), rows)

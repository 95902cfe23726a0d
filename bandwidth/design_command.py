"""``skin design``: a search for the layout that meets a requirement."""

from pathlib import Path

import tomli_w

from bandwidth.search import CanKind, Requirement, SendingKind, search
from bandwidth.traffic import Disturbance
from canskin.errors import InputError, LayoutError, RunError
from shell.output import write_file
from shell.service import say
from shell.terminal import Json, print_json
from skin.importing import tables_of
from skin.layout import Taxels, layout_text, parse_layout


def design(
    taxels: str,
    *,
    rate: float = 100.0,
    buses: int = 4,
    budget: float = 0.8,
    can: CanKind = "any",
    sending: SendingKind = "any",
    out: Path | None = None,
    disturbance: Disturbance | None = None,
    json_: Json = False,
) -> int:
    """Search for a layout whose buses carry a number of taxels at a rate.

    Exit code 1: no layout was found.

    Parameters
    ----------
    taxels
        Number of taxels; or rows and columns, as 24x32; or a file of taxels, as `skin layout new` takes.
    rate
        Measurements per second of synchronous sums; adaptive sums come up to 1000 times a second, as they have news.
    buses
        Largest number of buses.
    budget
        Highest load of a bus, with the most stuff bits, as a part of 1; of adaptive sums under simulated touches.
    can
        Type of CAN.
    sending
        ``any``: synchronous sums, or adaptive sums where synchronous sums do not fit.
    out
        File for the TOML of the layout. Default: print the layout.
    disturbance
        Disturbances that response times include.
    json_
        Print one JSON object.

    Examples
    --------
    skin design --taxels 1024 --can fd
    skin design --taxels 4096 --rate 100 --buses 2 --budget 0.7 --out palm.toml
    skin design --taxels 24x32 --sending adaptive --out glove.toml
    skin design --taxels hand --rate 200 --can classic
    """
    required = Requirement(_taxels(taxels), rate_hz=rate, buses=buses, budget=budget, can=can, sending=sending)
    found = search(required, disturbance)
    text = None if found.layout is None else layout_text(found.layout)
    if text is not None and out is not None:
        try:
            write_file(out, text)
        except OSError as error:
            raise InputError(f"{out}: cannot write the layout: {error.strerror or error}") from error
    if json_:
        print_json(
            {
                "required": required,
                "fits": text is not None,
                "layout": text,
                "missing": found.missing(),
                "candidates": found.candidates,
            }
        )
        return int(text is None)
    if text is None or found.chosen is None:
        raise RunError(found.missing() or "")
    unfit = sum(not each.fits for each in found.candidates)
    say("design", f"{found.chosen.words}: {found.chosen.load_words}; {unfit} others do not fit")
    print(str(out) if out is not None else text, end="\n" if out is not None else "")
    return 0


def _taxels(text: str) -> int | Taxels:
    """Return a number of taxels, or the taxels themselves."""
    if text.isdecimal():
        return int(text)
    try:
        return parse_layout(tomli_w.dumps(tables_of(text)[0]).encode(), "--taxels").taxels
    except LayoutError as error:
        raise InputError(f"--taxels: expected a number, ROWSxCOLUMNS, or a file of taxels: {error}") from error

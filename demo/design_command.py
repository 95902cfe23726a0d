"""``skin design``: a search for the layout that meets a requirement."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import tomli_w

from bandwidth.search import Candidate, CanKind, Requirement, Search, SendingKind, search
from bandwidth.traffic import Disturbance
from bandwidth.wiring import wiring
from canskin.errors import InputError, LayoutError, RunError, reasoned
from shell.output import check_new_path, write_file
from shell.service import say
from shell.terminal import Json, print_json, progress
from skin.choice import ROOM, scan_words
from skin.importing import new_name, tables_of
from skin.layout import Layout, Taxels, changed, layout_text, parse_layout, validated

if TYPE_CHECKING:
    from demo.quality import Quality


def design(
    taxels: str,
    *,
    rate: float = 100.0,
    buses: int = 4,
    budget: float = ROOM,
    can: CanKind = "any",
    sending: SendingKind = "any",
    min_psnr: float | None = None,
    out: Path | None = None,
    disturbance: Disturbance | None = None,
    json_: Json = False,
) -> int:
    """Search for a layout whose buses carry a number of taxels at a rate.

    Exit code 1: no layout was found. Images of simulated touches are judged where that takes some seconds; of more than
    512 stepped taxels, and of more than 8192 taxels, by ``skin plan --quality``. Above 250 Hz the chain of simulated
    boards runs for some seconds, too, to find which cycles this host keeps. With ``--min-psnr`` images are judged with
    16, 8, 4, 2 and 1 taxels to a sum, and the layout has the fewest sums whose images are good enough. Boards of sums
    in cycles average up to 1000 samples a second.

    Parameters
    ----------
    taxels
        Number of taxels; or rows and columns, as 24x32; or a file of taxels, as `skin layout new` takes.
    rate
        Measurements per second of synchronous sums; steps come up to 1000 times a second, as they have news.
    buses
        Largest number of buses.
    budget
        Highest load of a bus, with the most stuff bits, as a part of 1; of steps under simulated touches.
    can
        Type of CAN.
    sending
        ``any``: synchronous sums, or steps where synchronous sums do not fit.
    min_psnr
        Least PSNR of the images of synchronous sums, decibels.
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
    skin design --taxels 24x32 --sending steps --out glove.toml
    skin design --taxels 24x32 --min-psnr 28
    skin design --taxels hand --rate 200 --can classic
    """
    if out is not None:
        check_new_path(out, "layout", ".toml")
    required = Requirement(_taxels(taxels), rate_hz=rate, buses=buses, budget=budget, can=can, sending=sending)
    with progress("search", None) as bar:
        found = search(required, disturbance, lambda tried: bar.update(0, f"search: {tried.words}"))
    if found.layout is not None:
        asked_s = disturbance.jitter_s if disturbance is not None else None
        device = {} if asked_s is None else {"jitter_s": asked_s}
        found = replace(found, layout=changed(found.layout, name=new_name(taxels, out), device=device))
    judged: list[Quality] = [] if found.layout is None else _judged(found.layout, every=min_psnr is not None)
    if min_psnr is not None:
        found = _good_enough(found, judged, min_psnr)
    text = None if found.layout is None else layout_text(found.layout)
    if text is not None and out is not None:
        with reasoned(InputError, f"{out}: cannot write the layout"):
            write_file(out, text)
    if json_:
        print_json(
            {
                "required": required,
                "fits": text is not None,
                "layout": text,
                "missing": found.missing(),
                "quality": [each._asdict() for each in judged],
                "candidates": found.candidates,
            }
        )
        return int(text is None)
    if text is None or found.chosen is None:
        raise RunError(found.missing() or "")
    _tell(found, found.chosen, judged)
    print(str(out) if out is not None else text, end="\n" if out is not None else "")
    return 0


def _tell(found: Search, chosen: Candidate, judged: "Sequence[Quality]") -> None:
    """Tell what is known of a layout that fits."""
    for each in judged:
        say("design", f"images, {each.sums} sums: {each.words}; the paper's bound is {each.bound_sums:.0f} sums")
    if not judged:
        say("design", "images: not predicted, which takes longer than the search: 'skin plan FILE --quality'")
    if found.layout is not None and found.layout.sends.in_cycles and found.layout.samples_per_sync > 1:
        samples = f"{found.layout.samples_per_sync} samples of each taxel between two SYNCs"
        say(
            "design",
            f"boards average {samples}, for less noise",
        )
    if found.layout is not None:
        say("design", str(wiring(found.layout)))
        if scan := scan_words(found.layout):
            say("design", scan)
    unfit = sum(not each.fits for each in found.candidates)
    say("design", f"{chosen.words}: {chosen.load_words}; {unfit} others do not fit")
    if chosen.sending == "steps" and (lacking := found.nearest_in_cycles()):
        say("design", f"of synchronous sums {lacking}")


def _judged(layout: Layout, *, every: bool) -> "list[Quality]":
    """Return the quality of the layout, or with `every` number of sums; none where the simulation takes long."""
    from demo.prediction import say_of_host  # compiles a solver
    from demo.quality import is_quick, qualities, quality

    found = qualities(layout) if every else [quality(layout)] if is_quick(layout) else []
    if found:
        say_of_host("design", layout)
    return found


def _good_enough(found: Search, judged: "Sequence[Quality]", min_psnr_db: float) -> Search:
    """Return a search with the fewest sums whose images are good enough, of those that the buses carry."""
    layout, chosen = found.layout, found.chosen
    if layout is None or chosen is None:
        return found
    most = layout.measurement.sums
    enough = [each.sums for each in judged if each.psnr_image_db >= min_psnr_db and each.sums <= most]
    if not enough:
        best_db = max(each.psnr_image_db for each in judged if each.sums <= most)
        raise RunError(
            f"images have {best_db:.1f} dB at best with the {most} sums that the buses carry, expected {min_psnr_db:g}:"
            " allow more buses or a higher budget, or ask for less"
        )
    fewer = min(enough)
    reduced = validated(changed(layout, measurement={"sums": fewer}))
    return replace(found, chosen=replace(chosen, sums=fewer), layout=reduced)


def _taxels(text: str) -> int | Taxels:
    """Return a number of taxels, or the taxels themselves."""
    if text.isdecimal():
        return int(text)
    try:
        tables, told = tables_of(text)
        if tables.pop("measurement", None) is not None:
            told.append("the boards of the file are left out: a design has boards of its own")
        for words in told:
            say("design", words)
        return parse_layout(tomli_w.dumps(tables).encode(), "--taxels").taxels
    except LayoutError as error:
        raise InputError(f"--taxels: expected a number, ROWSxCOLUMNS, or a file of taxels: {error}") from error

"""The search of ``skin plan --taxels``: its options, and what is told of its result."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import tomli_w
from cyclopts import Group, Parameter

from bandwidth.search import Candidate, CanKind, Requirement, Search, SendingKind, search
from bandwidth.traffic import Disturbance
from bandwidth.wiring import wiring
from canskin.errors import InputError, LayoutError, RunError, reasoned
from shell.neighbours import new_serial, require_new, tell_shared
from shell.output import check_new_path, write_file
from shell.service import say
from shell.terminal import print_json, progress
from skin.choice import ROOM, scan_words
from skin.importing import new_name, tables_of
from skin.layout import Layout, Taxels, changed, layout_text, parse_layout


@Parameter(name="*", group=Group("Search for a layout"))
@dataclass(frozen=True)
class DesignOptions:
    """What is sought. Boards of sums in cycles average up to 1000 samples a second.

    Attributes
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
    out
        File for the TOML of the layout. Default: print the layout.
    """

    taxels: str | None = None
    rate: float = 100.0
    buses: int = 4
    budget: float = ROOM
    can: CanKind = "any"
    sending: SendingKind = "any"
    out: Path | None = None


#: Without a search.
NO_DESIGN: Final = DesignOptions()


def design(options: DesignOptions, disturbance: Disturbance | None, *, as_json: bool) -> int:
    """Search for a layout, write or print it, and return 1 if none was found.

    Raises
    ------
    InputError
        If an option has no sense, or the file of the layout cannot be written.
    RunError
        If no layout was found; with `as_json` that is told on stdout.
    """
    taxels, out = options.taxels, options.out
    if taxels is None:
        raise InputError("a search needs --taxels: their number, ROWSxCOLUMNS, or a file of taxels")
    if out is not None:
        check_new_path(out, "layout", ".toml")
    name = new_name(taxels, out)
    require_new(name)
    required = Requirement(
        _taxels(taxels),
        rate_hz=options.rate,
        buses=options.buses,
        budget=options.budget,
        can=options.can,
        sending=options.sending,
    )
    with progress("search", None) as bar:
        found = search(required, disturbance, lambda tried: bar.update(0, f"search: {tried.words}"))
    text = None
    if found.layout is not None:
        asked_s = disturbance.jitter_s if disturbance is not None else None
        device = {"first_serial": new_serial(name)} | ({} if asked_s is None else {"jitter_s": asked_s})
        layout = changed(found.layout, name=name, device=device)
        tell_shared(layout, "plan")
        found, text = replace(found, layout=layout), layout_text(layout)
    if text is not None and out is not None:
        with reasoned(InputError, f"{out}: cannot write the layout"):
            write_file(out, text)
    if as_json:
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
    if found.layout is None or found.chosen is None:
        raise RunError(found.missing() or "")
    _tell(found, found.layout, found.chosen)
    print(str(out) if out is not None else text, end="\n" if out is not None else "")
    return 0


def _tell(found: Search, layout: Layout, chosen: Candidate) -> None:
    """Tell what is known of a layout that fits."""
    from bandwidth.quality import is_quick, quality  # compiles a solver

    if is_quick(layout):
        with progress("touches, for the images", None):
            judged = quality(layout)
        say("plan", f"images, {judged.sums} sums: {judged.words}; the paper's bound is {judged.bound_sums:.0f} sums")
    else:
        say("plan", "images: not predicted, which takes longer than the search: 'skin plan FILE --quality'")
    if layout.sends.in_cycles and layout.samples_per_sync > 1:
        samples = f"{layout.samples_per_sync} samples of each taxel between two SYNCs"
        say("plan", f"boards average {samples}, for less noise")
    say("plan", str(wiring(layout)))
    if scan := scan_words(layout):
        say("plan", scan)
    sums, taxels = layout.measurement.sums, layout.taxels.there
    none = ": nothing is compressed" * (sums >= taxels)
    say("plan", f"{sums / taxels:.3g} sums per taxel, {sums} of {taxels}{none}")
    unfit = sum(not each.fits for each in found.candidates)
    say("plan", f"{chosen.words}: {chosen.load_words}; {unfit} others do not fit")
    if chosen.sending == "steps" and (lacking := found.nearest_in_cycles()):
        say("plan", f"of synchronous sums {lacking}")


def _taxels(text: str) -> int | Taxels:
    """Return a number of taxels, or the taxels themselves."""
    if text.removeprefix("-").isdecimal():
        return int(text)
    try:
        tables, told = tables_of(text)
        if tables.pop("measurement", None) is not None:
            told.append("the boards of the file are left out: a design has boards of its own")
        for words in told:
            say("plan", words)
        return parse_layout(tomli_w.dumps(tables).encode(), "--taxels").taxels
    except LayoutError as error:
        raise InputError(f"--taxels: expected a number, ROWSxCOLUMNS, or a file of taxels: {error}") from error

"""`docs/faults.md` from the scenes of the tests: each fault is played, and timed. `make docs` writes the page."""

from pathlib import Path
from typing import Final

from tests.health.scenes import SCENES, Scene, played

PAGE: Final = Path(__file__).with_name("faults.md")
_HEAD: Final = """# Faults

`make docs` writes this page from scenes on a simulated bus with a virtual clock: four nodes, SYNC at 20 Hz, counters
five times a second. A fault lasts 4 s where its row says nothing else; no wrong block was ever valid.

Named: when each cause is on the page, seconds after the fault has begun. Whole: when every block is valid again, after
the fault has ended; "always" where none became invalid. Calm: when nothing is named any more. `docs/reference.md` says
what to do at each cause.

Two boards with one node-ID: a node is out until ten seconds after its sums came twice, and differed, in two cycles of a
second. What is not found: when one of the boards answers the gateway, and has sent no sums since the other came,
nothing comes twice. Then the sums of the other are taken for its own. Nor are two cables that are exchanged within
1.5 s while the interfaces stay: boards with equal identifiers are taken for each other until their proofs come, in
turn.

| fault | named | whole | calm |
|---|---|---|---|
"""


def page() -> str:
    """Return the page."""
    return _HEAD + "".join(f"| {' | '.join(_row(scene))} |\n" for scene in SCENES)


def _row(scene: Scene) -> tuple[str, ...]:
    found = played(scene)
    named = ", ".join(f"`{code}` {at_s:.1f}" for code, at_s in found.named_s.items())
    whole = "always" if found.whole_s is None else f"{found.whole_s:.1f}"
    lasts = {0.0: ", once", 4.0: ""}.get(scene.lasts_s, f", {scene.lasts_s:g} s")
    return scene.fault + lasts, named or "-", whole, f"{found.silent_s:.1f}" if named else "-"


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")

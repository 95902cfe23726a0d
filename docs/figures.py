"""Makes every picture of the README and of docs/.

``make figures`` makes all pictures of `FIGURES`, ``make figures ARGS="demo.png page.png"`` two of them. The paper's
figures need the meshes of its objects, ``MESHES=DIR`` in the environment; `page.png` and `rerun.png` need chromium.
"""

import base64
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Final

import httpx

from docs.monitor_picture import monitor
from docs.rerun_picture import rerun
from shell.output import write_file
from tests.browser import CHROMIUM, Browser, chromium
from tests.processes import Processes, free_port

DOCS: Final = Path(__file__).parent
SKIN: Final = (sys.executable, "-m", "skin")
#: Time from the label of the golf ball to the picture, so that all figures on the page are those of a touch.
TOUCHED_S: Final = 1.5
PATIENCE_S: Final = 120.0
PAGE_WIDTH, PAGE_HEIGHT = 1280, 860


def demo(path: Path) -> None:
    """One cycle of the golf ball through the whole chain."""
    _run("demo", "--seconds", "10", "--objects", "golf-ball", "--no-view", "--figure", str(path))


def boards(path: Path) -> None:
    """Draw the boards of a hand."""
    _run("layout", "draw", "hand", "--out", str(path))


def page(path: Path, layout: str = "default") -> None:
    """Take a picture of the web page while the golf ball touches."""
    if CHROMIUM is None:
        raise RuntimeError("expected chromium on PATH")
    port = free_port()
    with tempfile.TemporaryDirectory() as folder, Processes(Path(folder)) as processes:
        figure = str(Path(folder) / "demo.png")
        touch = "--layout", layout, "--seconds", "300", "--objects", "golf-ball"
        processes.skin("demo", "demo", *touch, "--port", str(port), "--figure", figure)
        processes.until(lambda: "fabric:" in processes.log("demo").read_text(), "the web page")
        address = f"http://127.0.0.1:{port}/"
        # Chromium takes a whole core, so it starts only when the ball touches.
        processes.until(lambda: _object(address) == "golf-ball", "the golf ball to be named")
        profile = Path(folder) / "chromium"
        profile.mkdir()
        with chromium(profile) as browser:
            browser.open(address, width=PAGE_WIDTH, height=PAGE_HEIGHT)
            touches = "the golf ball was not named"
            is_named = partial(_is_named, browser)
            while True:  # a touch may end before its picture
                browser.until(is_named, touches, PATIENCE_S)
                browser.wait(TOUCHED_S)
                picture = browser.picture()
                if is_named():
                    break
            write_file(path, picture)
        processes.stop("demo", signal.SIGINT)


def _is_named(browser: Browser) -> bool:
    return "golf ball" in browser.text("#object")


def _object(address: str) -> str:
    """Return the object that a page names now."""
    label = httpx.get(f"{address}api/state").json()["label"]
    return label["label"] if label and not label["stale"] else ""


def paper_images(path: Path) -> None:
    """Take the drill's sample images from the report of the paper's figures."""
    write_file(path, _from_report("The drill"))


def paper_psnr(path: Path) -> None:
    """Take the clamp's PSNR over time from the report of the paper's figures."""
    write_file(path, _from_report("PSNR of the clamp's images over time"))


#: File in docs/, and the function that makes it.
FIGURES: Final[dict[str, Callable[[Path], None]]] = {
    "demo.png": demo,
    "hand-boards.png": boards,
    "page.png": page,
    "hand-page.png": partial(page, layout="hand"),
    "forearm-page.png": partial(page, layout="forearm"),
    "monitor.svg": partial(monitor, size=(80, 24)),
    "monitor-large.svg": partial(monitor, size=(200, 50)),
    "rerun.png": rerun,
    "paper-images.png": paper_images,
    "paper-psnr.png": paper_psnr,
}


def _from_report(caption: str) -> bytes:
    """Return the picture whose caption begins with `caption`; the report is made once and kept in build/figures."""
    meshes = os.environ.get("MESHES")
    if not meshes:
        raise RuntimeError("expected the folder of the paper's meshes: MESHES=DIR")
    folder = DOCS.parent / "build/figures"
    report = folder / "report.html"
    if not report.exists():
        _run("evaluate", "paper", "figures", "--meshes", meshes, "--out", str(folder))
    return _picture(report, caption)


def _picture(report: Path, caption: str) -> bytes:
    """Return the picture of a report whose caption begins with `caption`."""
    found = re.findall(r'<img alt="([^"]*)" src="data:image/png;base64,([^"]*)"', report.read_text(encoding="utf-8"))
    return next(base64.b64decode(data) for alt, data in found if alt.replace("&#x27;", "'").startswith(caption))


def _run(*arguments: str) -> None:
    subprocess.run([*SKIN, *arguments], check=True)


def main(names: Sequence[str]) -> int:
    """Make figures; return the exit status."""
    unknown = [name for name in names if name not in FIGURES]
    if unknown:
        print(f"figures: expected some of {', '.join(FIGURES)}, got {', '.join(unknown)}", file=sys.stderr)
        return 2
    failed = 0
    for name in names or FIGURES:
        print(f"figures: {name}", file=sys.stderr, flush=True)
        try:
            FIGURES[name](DOCS / name)
        except (RuntimeError, OSError, AssertionError, subprocess.CalledProcessError) as error:
            failed += 1
            print(f"figures: {name} was not made: {error}", file=sys.stderr)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

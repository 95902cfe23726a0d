"""The page of a skin that is no grid, in a real browser."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from canskin.messages import Contacts
from skin.layout import Layout
from tests import messages as make
from tests.browser import CHROMIUM, Browser
from tests.health.helpers import Messages
from tests.layouts import buses, small_layout, tube_layout
from tests.views.page.conftest import Chain, Server
from views.page.wire import greeting

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="NOT TESTED: the page in a browser, for want of chromium"),
]
TWO_BUSES = {"name": "palm", "bus": buses(4, 4, names=("left", "right"))}
CURVED = tube_layout(16, 16, **TWO_BUSES)
#: The taxels of a grid of 16 x 16 as positions.
FLAT = tube_layout(1, 256, **TWO_BUSES, taxels={"positions": small_layout(16, 16).taxels.surface.positions_m.tolist()})


@dataclass
class SurfaceMessages(Messages):
    """Messages of a touch around `TOUCHED`."""

    layout: Layout

    def grid(self, force_n: float = 0.01) -> np.ndarray:
        away_m = np.linalg.norm(self.surface.positions_m - self.surface.positions_m[TOUCHED], axis=1)
        return np.float32(force_n * np.clip(1 - away_m / 0.05, 0, None))[None]

    @property
    def surface(self) -> Any:
        return self.layout.taxels.surface

    def contacts(self, cycle: int = 1, *, sync_s: float = 1.0, doubtful: bool = False, **_: Any) -> Contacts:
        place, normal = self.surface.positions_m[TOUCHED].tolist(), self.surface.normals[TOUCHED].tolist()
        contact = make.contact(
            identity=7, row=0.0, column=float(TOUCHED), taxels=9, position_m=place, normal=normal,
            doubtful_since_mono_ns=int(doubtful),
        )  # fmt: skip
        return make.contacts(cycle, contact, sampled_mono_ns=round(sync_s * 1e9))


#: In the middle of the curved skin.
TOUCHED = 120


@pytest.fixture
def messages(request: pytest.FixtureRequest) -> SurfaceMessages:
    return SurfaceMessages(getattr(request, "param", CURVED))


@pytest.fixture
def page(browser: Browser, server: Server, chain: Chain, messages: SurfaceMessages) -> Iterator[Browser]:
    chain.contacts = False
    browser.complaints.clear()
    browser.open(server.address, height=900)  # a taxel seen from its side has a pixel in the small images, too
    browser.until(lambda: "golf ball" in browser.text("#object"), "no label was shown")
    browser.until(lambda: browser.ask("!document.querySelector('#map-true').hidden"), "no truth was shown")
    browser.until(lambda: bool(colours(browser, messages)[:, 3].all()), "no image was drawn")
    yield browser
    assert not browser.complaints
    browser.open("about:blank")  # before the server stops, of which the page would complain


def pixels(messages: SurfaceMessages, box: dict[str, float]) -> np.ndarray:
    """Return x and y of each taxel, as the page is opened, on a canvas with this `box`; shape (256, 2)."""
    about = greeting(messages.layout)["surface"]
    seen = (messages.surface.positions_m - about["middle_m"]) @ np.array(about["view"])[:2].T / about["pitch_m"]
    shares = seen / (about["width"], about["height"]) + 0.5
    return (box["x"], box["y"]) + shares * (box["width"], box["height"])


def box_of(page: Browser) -> dict[str, float]:
    rectangle = "document.querySelector('#map-image canvas').getBoundingClientRect()"
    found: dict[str, float] = json.loads(page.ask(f"JSON.stringify({rectangle})"))
    return found


def colours(page: Browser, messages: SurfaceMessages, name: str = "image") -> np.ndarray:
    """Return red, green, blue and alpha at the places of the taxels, as the page is opened, shape (256, 4)."""
    size = page.ask(f"(({{width, height}}) => [width, height])(document.querySelector('#map-{name} canvas'))")
    places = pixels(messages, {"x": 0, "y": 0, "width": size[0], "height": size[1]}).tolist()
    script = f"""(() => {{
      const brush = document.querySelector("#map-{name} canvas").getContext("2d");
      return {json.dumps(places)}.flatMap(([x, y]) => [...brush.getImageData(x, y, 1, 1).data]);
    }})()"""
    return np.array(page.ask(script)).reshape(-1, 4)


def differing(page: Browser, messages: SurfaceMessages) -> set[int]:
    """Return the taxels whose colour is another in the true image, all while a frame came without one."""
    differs = (colours(page, messages) != colours(page, messages, "true")).any(axis=1)
    return set(np.flatnonzero(differs).tolist())


def drag(page: Browser, right: float, down: float) -> None:
    """Drag the image by parts of its size."""
    box = box_of(page)
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    mouse = {"button": "left", "buttons": 1, "clickCount": 1}
    page.call("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, **mouse)
    x, y = x + right * box["width"], y + down * box["height"]
    page.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y, **mouse)
    page.call("Input.dispatchMouseEvent", type="mouseReleased", x=x, y=y, **mouse)


@pytest.mark.parametrize("messages", [CURVED, FLAT], ids=["curved", "flat"], indirect=True)
def test_taxels_are_drawn_in_their_places(page: Browser, messages: SurfaceMessages) -> None:
    assert "palm · 256 taxels" in page.text("#skin")
    luminance = colours(page, messages)[:, :3] @ [0.2126, 0.7152, 0.0722]
    order = np.argsort(messages.grid(), axis=None)
    assert (np.diff(luminance[order]) >= -1.0).all()
    assert luminance[order[-1]] > luminance[order[0]] + 40
    page.until(lambda: not differing(page, messages), "the true image is drawn otherwise")
    assert page.ask(
        "document.querySelector('#map-image canvas').getContext('2d').getImageData(0, 0, 1, 1).data[3]"
    ) == (255 if messages.surface.is_flat else 0)


def test_taxels_of_invalid_blocks_are_hatched(page: Browser, chain: Chain, messages: SurfaceMessages) -> None:
    chain.invalid = (3,)
    page.until(lambda: "7 / 8" in page.text("#blocks"), "the invalid block was not counted")
    hatched = set(np.flatnonzero(messages.layout.phi().block_of_taxel == 3).tolist())
    page.until(lambda: differing(page, messages) == hatched, "others are hatched")


def test_the_pointer_names_a_taxel_and_where_it_lies(page: Browser, messages: SurfaceMessages) -> None:
    page.point(*pixels(messages, box_of(page))[37])
    page.until(lambda: "taxel 37 at x" in page.text("#readout"), "the pointer was not followed")
    x, y, z = 1e3 * messages.surface.positions_m[37]
    assert f"taxel 37 at x {x:.1f}, y {y:.1f}, z {z:.1f} mm: " in page.text("#readout")
    assert f"{1000 * messages.grid()[0, 37]:.2f} mN" in page.text("#readout")


def test_a_curved_skin_is_turned_by_mouse_and_keys(page: Browser, chain: Chain, messages: SurfaceMessages) -> None:
    chain.images = True
    page.until(lambda: "arrow keys" in page.text("#readout"), "the page does not say how to turn")
    at_first = colours(page, messages)
    drag(page, 1.0, 0.0)  # half a turn: the inside of the half tube is seen, and no taxel
    page.until(lambda: len(np.unique(colours(page, messages), axis=0)) == 1, "the skin was not turned")
    page.call("Input.dispatchKeyEvent", type="keyDown", key="Home")
    page.until(lambda: bool(np.array_equal(colours(page, messages), at_first)), "the skin was not turned back")
    for _ in range(3):
        page.call("Input.dispatchKeyEvent", type="keyDown", key="ArrowLeft")
    page.until(lambda: not np.array_equal(colours(page, messages), at_first), "no key turns the skin")
    # All are turned alike; the true one is smaller, and the borders of its taxels lie on other pixels.
    page.until(
        lambda: np.mean((colours(page, messages) == colours(page, messages, "true")).all(axis=1)) > 0.8, "one is turned"
    )


def test_contacts_are_marked_on_the_side_that_is_seen(page: Browser, chain: Chain, messages: SurfaceMessages) -> None:
    chain.contacts = True
    x, y, z = 1e3 * messages.surface.positions_m[TOUCHED]
    page.until(lambda: f"{x:.1f}, {y:.1f}, {z:.1f}" in page.text("#contacts tbody .place"), "no contact")
    away_m = np.linalg.norm(messages.surface.positions_m - messages.surface.positions_m[TOUCHED], axis=1)
    beside = set(np.flatnonzero(away_m < 4 * messages.surface.pitch_m).tolist())
    page.until(lambda: {TOUCHED} <= differing(page, messages) <= beside, "the contact has no mark, or others have")
    chain.doubtful = True
    page.until(lambda: "in doubt" in page.text("#contacts tbody"), "no doubt was told")
    drag(page, 1.0, 0.0)
    page.until(lambda: not differing(page, messages), "the contact is marked on the other side")


@pytest.mark.parametrize("messages", [FLAT], indirect=True)
def test_a_flat_skin_is_not_turned(page: Browser, messages: SurfaceMessages) -> None:
    page.until(lambda: "Point at a taxel" in page.text("#readout"), "no advice")
    assert "turn" not in page.text("#readout")
    before = colours(page, messages)
    drag(page, 0.5, 0.2)
    page.wait(0.1)
    np.testing.assert_array_equal(colours(page, messages), before)


def test_the_page_fits_a_phone(browser: Browser, server: Server) -> None:
    browser.open(server.address, width=390)
    browser.until(lambda: "golf ball" in browser.text("#object"), "no label was shown")
    assert browser.ask("document.documentElement.scrollWidth") == 390
    assert browser.ask("document.querySelector('#map-image canvas').clientWidth") == 366

"""The page in a real browser."""

from typing import Any

import numpy as np
import pytest

from canskin.fabric import Fabric
from tests.browser import CHROMIUM, Browser
from tests.views.page.conftest import Chain, Server

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="NOT TESTED: the page in a browser, for want of chromium"),
]

LOST = "dead: the gateway has lost its interface"


def pixels(page: Browser, name: str) -> Any:
    """Colours in the middle of every taxel, shape (16, 16, 3)."""
    script = f"""(() => {{
      const canvas = document.querySelector("#map-{name} canvas"), cell = canvas.width / 16;
      const brush = canvas.getContext("2d"), found = [];
      for (let row = 0; row < 16; row++) for (let column = 0; column < 16; column++)
        found.push(...brush.getImageData((column + .5) * cell, (row + .5) * cell, 1, 1).data.slice(0, 3));
      return found;
    }})()"""
    return np.array(page.ask(script)).reshape(16, 16, 3)


def test_page_shows_images_figures_and_buses(page: Browser, messages: Any) -> None:
    page.until(lambda: "dB" in page.text("#psnr"), "no PSNR was shown")
    assert "93 % sure" in page.text("#object")
    assert "5.0 ms" in page.text("#latency")
    assert "8 / 8" in page.text("#blocks")
    assert page.ask("document.querySelectorAll('.tile.operational[title]').length") == 8
    assert page.text("#notices") == ""
    # The brighter the taxel, the larger its force: luminance orders the taxels as the forces do.
    luminance = pixels(page, "image") @ [0.2126, 0.7152, 0.0722]
    force = messages.grid()
    order = np.argsort(force, axis=None)
    assert (np.diff(luminance.flat[order]) >= -1.0).all()
    assert luminance.flat[order[-1]] > luminance.flat[order[0]] + 40
    np.testing.assert_array_equal(pixels(page, "image"), pixels(page, "true"))
    assert not page.complaints


def test_taxels_of_invalid_blocks_are_hatched(page: Browser, chain: Chain, messages: Any) -> None:
    chain.invalid = (3,)
    page.until(lambda: "7 / 8" in page.text("#blocks"), "the invalid block was not counted")
    size = messages.layout.measurement.block_size
    hatched = set(messages.layout.phi().order[3 * size : 4 * size].tolist())
    differs = (pixels(page, "image") != pixels(page, "true")).any(axis=2)
    assert set(np.flatnonzero(differs).tolist()) == hatched


def test_contacts_are_marked_and_described_while_they_come(page: Browser, chain: Chain) -> None:
    chain.contacts = True
    page.until(lambda: "contact 7" in page.text("#readout"), "no contact was described")
    assert "at row 7.5, column 6.0, 113 taxels, 4 not measured" in page.text("#readout")
    marked = np.flatnonzero((pixels(page, "image") != pixels(page, "true")).any(axis=2).any(axis=0))
    assert set(marked.tolist()) & {5, 6, 7}
    chain.doubtful = True
    page.until(lambda: "4 not measured, in doubt" in page.text("#readout"), "no doubt was told")
    assert "in doubt for" in page.text("#notices")
    chain.contacts = False
    page.until(lambda: "contact" not in page.text("#readout"), "an old contact is still described")
    np.testing.assert_array_equal(pixels(page, "image"), pixels(page, "true"))


def test_pointer_names_force_block_and_node(page: Browser, messages: Any) -> None:
    box = page.ask("JSON.parse(JSON.stringify(document.querySelector('#map-image canvas').getBoundingClientRect()))")
    page.point(box["x"] + box["width"] * 6.5 / 16, box["y"] + box["height"] * 7.5 / 16)
    order = messages.layout.phi().order
    block = int(np.flatnonzero(order == 7 * 16 + 6)[0]) // 32
    bus, node = ("left", "right")[block // 4], block % 4 + 1
    page.until(lambda: "row 7, column 6" in page.text("#readout"), "the pointer was not followed")
    readout = page.text("#readout")
    assert f"{1000 * messages.grid()[7, 6]:.2f} mN" in readout
    assert f"block {block} · {bus} node {node}, operational" in readout
    assert page.ask("document.querySelector('.tile.marked').title") == f"{bus}, node {node}: operational"


def test_images_that_stop_are_marked_and_explained(page: Browser, chain: Chain) -> None:
    chain.images = False
    chain.reconstructor.close()
    page.until(lambda: "images stopped: reconstructor is gone (since" in page.text("#notices"), "no notice")
    assert "stale" in page.text("#map-image .veil")
    assert page.ask("document.querySelector('#map-image').classList.contains('stale')")
    assert not page.ask("document.querySelector('#map-true').classList.contains('stale')")


def test_without_truth_only_the_image_is_there(page: Browser, chain: Chain) -> None:
    assert page.ask("document.querySelector('#map-true').hidden") is False
    chain.truths = False
    page.until(lambda: page.ask("document.querySelector('#map-true').hidden"), "the true image stayed")
    assert page.ask("document.querySelector('#map-sensor').hidden")
    assert "no truth published" in page.text("#psnr")


def test_nodes_off_duty_are_seen(page: Browser, chain: Chain) -> None:
    chain.gateway = {"nmt": ((5, 255, 127, 4), (5, 5, 5, 5)), "refused": (3,)}
    page.until(lambda: "left: node 2 silent" in page.text("#notices"), "no notice")
    assert "left: node 3 refused by the gateway" in page.text("#notices")
    assert page.ask("[...document.querySelectorAll('#buses .tile')].map((tile) => tile.dataset.state).slice(0, 5)") == [
        "operational",
        "silent",
        "refused",
        "stopped",
        "operational",
    ]


def test_dead_skin_is_no_skin_without_contact(page: Browser, chain: Chain) -> None:
    chain.label = {"label": "", "valid_sums": 0}
    page.until(lambda: "not measured" in page.text("#object"), "the label of nothing was shown")
    assert "no contact" not in page.text("#object")
    assert page.ask("document.querySelector('#object').classList.contains('stale')")
    chain.label = {"label": ""}
    page.until(lambda: "no contact" in page.text("#object"), "a skin without contact was not shown")


def test_dead_buses_are_named_and_get_no_sync(page: Browser, chain: Chain) -> None:
    silent = (255, 255, 255, 255)
    chain.gateway = {"links": ("lost", "active"), "nmt": (silent, (5, 5, 5, 5)), "troubles": (LOST, "")}
    page.until(lambda: "bus left dead" in page.text("#notices"), "no notice")
    assert "SYNC 100.0 Hz on 1 of 2 buses" in page.text("#rate")
    chain.gateway = {"links": ("lost", "lost"), "nmt": (silent, silent), "troubles": (LOST, LOST)}
    page.until(lambda: "SYNC reaches no bus" in page.text("#rate"), "SYNC went on")
    assert page.text("#buses .detail") == "dead: no node can be heard"
    assert page.ask("document.querySelectorAll('#buses .tile.unknown').length") == 8
    # Nothing of it may be cut off, however narrow the card is.
    assert page.ask(
        "[...document.querySelectorAll('.bus .detail')].every((line) => line.scrollWidth <= line.clientWidth)"
    )


def test_lost_connection_is_told_and_mended(page: Browser, server: Server) -> None:
    server.stop()
    page.until(lambda: "connection to the viewer is lost" in page.text("#notices"), "no notice")
    assert page.text("#map-image .veil") == "stale: connection lost"
    assert page.ask("document.body.classList.contains('unconnected')")
    server.start()
    page.until(lambda: page.text("#notices") == "", "it did not connect again")
    assert not page.ask("document.body.classList.contains('unconnected')")
    assert page.text("#map-image .veil") == ""


@pytest.mark.parametrize("width", [1280, 1000, 800, 420])
def test_page_fits_its_window(browser: Browser, server: Server, width: int) -> None:
    browser.open(f"http://127.0.0.1:{server.port}/", width=width)
    browser.until(lambda: "golf ball" in browser.text("#object"), "no label was shown")
    assert browser.ask("document.documentElement.scrollWidth") <= width
    assert browser.ask("document.querySelector('#map-image canvas').width % 16") == 0
    assert browser.ask("document.querySelector('#map-image').clientWidth") >= min(256, width / 2)


def test_scale_follows_the_images_or_is_fixed(page: Browser) -> None:
    page.until(lambda: page.text("#scale li") == "10", "the scale did not follow the images")
    page.ask("document.querySelector('#scaling input[value=fixed]').click()")
    page.until(lambda: page.text("#scale li") == "20", "the scale was not fixed")


def test_frozen_reconstructor_is_not_green_and_its_figures_go(page: Browser, chain: Chain) -> None:
    chain.images = False
    page.until(lambda: "sends nothing" in page.text("#services li.silent"), "the frozen reconstructor stayed green")
    assert "reconstructor is there but sends none" in page.text("#notices")
    page.until(lambda: page.text("#rate .value") == page.text("#latency .value") == "–", "old figures stayed")
    assert page.text("#blocks .value") == "– / 8"


def test_figures_of_a_dead_skin_go(page: Browser, chain: Chain) -> None:
    silent = (255, 255, 255, 255)
    chain.gateway = {"links": ("lost", "lost"), "nmt": (silent, silent), "troubles": (LOST, LOST)}
    chain.invalid = tuple(range(8))
    page.until(lambda: page.text("#rate .value") == page.text("#latency .value") == "–", "old figures stayed")
    page.until(lambda: page.text("#buses .load") == "–", "the load of a dead bus stayed")
    assert "nothing is measured" in page.text("#latency .detail")


def test_service_of_another_phi_is_named_with_its_fingerprint(page: Browser, hub: Fabric, endpoint: str) -> None:
    assert page.text("#services li.differs") == ""
    other = Fabric("palm", "classifier", endpoint, fingerprint="0123456789abcdef")
    page.until(lambda: "classifier has Φ 0123456789abcdef" in page.text("#notices"), "no notice")
    assert "classifier" in page.text("#services li.differs")
    assert "Φ 0123456789abcdef" in page.ask("document.querySelector('#services li.differs').title")
    other.close()


def test_words_that_explain_amber_are_whole_on_a_phone(browser: Browser, server: Server, chain: Chain) -> None:
    chain.invalid = (3,)
    browser.open(f"http://127.0.0.1:{server.port}/", width=380)
    browser.until(lambda: "1 missing within 1 s" in browser.text("#blocks"), "the missing block was not told")
    assert browser.ask(
        "[...document.querySelectorAll('.detail')].every((line) => line.scrollWidth <= line.clientWidth)"
    )

"""Several skins: side by side on the first page, and each on a page of its own."""

from typing import Any

import httpx
import numpy as np
import pytest

from canskin.messages import IMAGE
from skin.layout import changed
from tests.browser import CHROMIUM, Browser
from tests.health.helpers import FabricStub, Messages
from tests.layouts import buses, tube_layout
from tests.views.page.conftest import Chain, Server
from views.page.app import Page
from views.page.shown import Live

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="NOT TESTED: the page in a browser, for want of chromium"),
]


def colours(page: Browser, skin: str) -> int:
    """Return how many colours the map of a skin has."""
    script = f"""(() => {{
      const canvas = document.querySelector('[data-skin="{skin}"] canvas');
      if (!canvas) return 0;
      const {{ data }} = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
      return new Set(new Uint32Array(data.buffer)).size;
    }})()"""
    return int(page.ask(script))


def test_skins_are_side_by_side_and_lead_to_pages_of_their_own(
    browser: Browser, server: Server, chain: Chain, messages: Any
) -> None:
    bent = tube_layout(16, 16, name="arm", bus=buses(4, 4, names=("left", "right")))
    fabric = FabricStub()
    silent = Live(changed(messages.layout, name="hand"), FabricStub().fabric)
    server.pages |= {"hand": Page(silent), "arm": Page(Live(bent, fabric.fabric))}
    browser.complaints.clear()
    browser.open(server.address)
    chain.contacts = True
    browser.until(lambda: "3 skins" in browser.text("#skin"), "the skins are not listed")
    pixels = np.linspace(0, 0.01, 256, dtype="<f4")[None]

    def is_shown() -> bool:
        fabric.handlers[IMAGE.name](lambda: Messages(bent).image(pixels=pixels))
        return min(colours(browser, "palm"), colours(browser, "arm")) > 20

    browser.until(is_shown, "no map was drawn")
    assert "golf ball" in browser.text('[data-skin="palm"] figcaption')
    assert browser.text('[data-skin="hand"] .veil') == "no image yet"
    browser.ask("document.querySelector('[data-skin=\"palm\"] a').click()")
    browser.until(lambda: "golf ball" in browser.text("#object"), "the skin has no page")
    browser.until(lambda: browser.ask("!document.querySelector('#tare').hidden"), "the page has no actions")
    assert browser.ask("location.pathname") == "/skins/palm/"
    assert "palm" in browser.text("#skin")
    assert not browser.complaints
    browser.open("about:blank")
    at = f"http://127.0.0.1:{server.port}"
    assert httpx.get(f"{at}/api/skins").json() == ["palm", "hand", "arm"]
    assert httpx.get(f"{at}/skins/hand/api/state").json()["skin"] == "hand"
    assert [httpx.get(f"{at}{path}").status_code for path in ("/api/state", "/skins/foot/api/state")] == [404, 404]

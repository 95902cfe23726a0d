"""The page in a real browser."""

import json
import re
import time
from typing import Any

import numpy as np
import pytest

from canskin.fabric import Fabric
from canskin.messages import MARK, Mark, NodeEmergency
from health.snapshot import PlaybackState
from tests.browser import CHROMIUM, Browser
from tests.views.page.conftest import Chain, Server
from views.page.actions import Record, SetMark, Tare

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="NOT TESTED: the page in a browser, for want of chromium"),
]

PLAYED = PlaybackState(path="runs/cup.mcap", position_s=12.0, duration_s=59.97, is_paused=False, speed=1.0)
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


def differing(page: Browser) -> set[int]:
    """Return the taxels whose colour is another in the true image, all while a frame came without one."""
    return set(np.flatnonzero((pixels(page, "image") != pixels(page, "true")).any(axis=2)).tolist())


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
    page.until(lambda: not differing(page), "the true image is drawn otherwise")
    assert not page.complaints


def test_taxels_of_invalid_blocks_are_hatched(page: Browser, chain: Chain, messages: Any) -> None:
    chain.invalid = (3,)
    page.until(lambda: "7 / 8" in page.text("#blocks"), "the invalid block was not counted")
    size = messages.layout.measurement.block_size
    hatched = set(messages.layout.phi().order[3 * size : 4 * size].tolist())
    page.until(lambda: differing(page) == hatched, "others are hatched")


def rows(page: Browser, table: str) -> list[list[str]]:
    """Texts of the cells of a table's body."""
    cells = "[...row.children].map((cell) => cell.innerText.trim())"
    found: list[list[str]] = page.ask(f"[...document.querySelectorAll('#{table} tbody tr')].map((row) => {cells})")
    return found


def ink(page: Browser, canvas: str, x: float, y: tuple[float, float] = (0.0, 1.0)) -> int:
    """Number of painted pixels in a column of a canvas; `x` and `y` are parts of its size. A line of time is none."""
    script = f"""(() => {{
      const canvas = document.querySelector("{canvas}"), high = canvas.height, top = Math.floor({y[0]} * high);
      return Math.min(...[0, 3].map((right) => {{
        const column = Math.min(canvas.width - 1, Math.floor({x} * canvas.width) + right);
        const {{ data }} = canvas.getContext("2d").getImageData(column, top, 1, Math.ceil(({y[1]} - {y[0]}) * high));
        return data.filter((value, place) => place % 4 === 3 && value > 0).length;
      }}));
    }})()"""
    return int(page.ask(script))


def press(page: Browser, key: str, modifiers: int = 0) -> None:
    for kind in ("keyDown", "keyUp"):
        page.call("Input.dispatchKeyEvent", type=kind, key=key, modifiers=modifiers)


def test_contacts_are_marked_and_listed_while_they_come(page: Browser, chain: Chain, messages: Any) -> None:
    chain.contacts = True
    page.until(lambda: len(rows(page, "contacts")) == 1, "no contact was listed")
    force_mn = f"{1000 * messages.grid().sum():.0f}"
    assert rows(page, "contacts")[0][:4] + rows(page, "contacts")[0][5:6] == ["7", force_mn, "10.0", "113", "7.5, 6.0"]
    assert "4 taxels not measured" in rows(page, "contacts")[0][6]
    page.until(lambda: 0 < len(differing(page)) < 256, "the contact has no mark")
    assert {each % 16 for each in differing(page)} & {5, 6, 7}
    page.until(lambda: ink(page, "#contacts tbody canvas", 0.999) > 2, "the contact has no curve")
    chain.doubtful = True
    page.until(lambda: "in doubt for" in rows(page, "contacts")[0][6], "no doubt was told")
    assert "in doubt for" in page.text("#notices")
    assert page.ask("document.querySelector('#contacts tbody tr').className") == "doubtful"
    chain.contacts = False
    page.until(lambda: not rows(page, "contacts"), "an old contact is still listed")
    page.until(lambda: not differing(page), "an old contact is still marked")


def test_the_past_is_shown_and_said_until_live_again(page: Browser, server: Server, chain: Chain) -> None:
    page.ask("document.querySelector('#scaling input[value=fixed]').click()")
    page.until(lambda: ink(page, "#scrub canvas", 0.999, (0.0, 0.25)) > 2, "no force was drawn")
    page.ask("document.querySelector('#pause').click()")
    page.until(
        lambda: page.text("#map-image .past").startswith("the past: "), "the page does not say that it is paused"
    )
    # Its frame was answered before the force changes: else the nearest may be of after.
    page.until(
        lambda: page.ask("performance.getEntriesByType('resource').some((each) => each.name.includes('/api/frame'))"),
        "the frame of the instant did not come",
    )
    before = pixels(page, "image")
    before_n = server.live.snapshot()[0].patches[0].force_n or 0.0
    chain.force_n = 0.02
    page.until(lambda: (server.live.snapshot()[0].patches[0].force_n or 0.0) > 1.5 * before_n, "the force did not come")
    said = page.text("#instant")
    page.until(lambda: page.text("#instant") != said, "the pause does not grow older")
    assert re.match(r"\d\d:\d\d:\d\d\.\d, [\d.]+ m?s? ?ago", page.text("#instant"))
    np.testing.assert_array_equal(pixels(page, "image"), before)
    shown = page.text("#map-image .past")
    press(page, ",")
    page.until(lambda: page.text("#map-image .past") != shown, "the keyboard did not go back")
    press(page, "l")
    page.until(lambda: page.text("#instant").startswith("now"), "the page is not live again")
    page.until(lambda: not np.array_equal(pixels(page, "image"), before), "the image of now was not drawn")
    box = page.ask("JSON.parse(JSON.stringify(document.querySelector('#scrub').getBoundingClientRect()))")
    at = {"x": box["x"] + box["width"] - 1, "y": box["y"] + 20, "button": "left", "buttons": 1, "clickCount": 1}
    page.call("Input.dispatchMouseEvent", type="mousePressed", **at)
    page.until(lambda: page.text("#instant").endswith("ago"), "the pointer did not scrub")
    page.call("Input.dispatchMouseEvent", type="mouseReleased", **at)
    assert page.text("#pause") == "Live"
    page.ask("document.querySelector('#pause').click()")
    page.until(lambda: page.text("#instant").startswith("now"), "the page is not live again")


def test_picture_figures_history_and_contacts_are_of_one_instant(page: Browser, chain: Chain, messages: Any) -> None:
    """Each cycle has another force and another label."""
    chain.contacts = chain.varies = True
    page.until(lambda: "object" in page.text("#object .value"), "the labels do not vary")
    page.until(lambda: page.text("#tracks dd") != "", "no history")
    names = ["#map-image figcaption span", "#map-true figcaption span", "#object .value", "#force .value"]
    names += ["#tracks dd", "#tracks div:last-child dd", "#contacts td.force"]
    script = f"{names}.map((name) => document.querySelector(name)?.innerText)"
    seen = set()

    def agrees() -> bool:
        cycle, *shown = page.ask(script)
        number = int(cycle.split()[1].strip(","))
        total_mn = f"{1000 * messages.grid(chain.force_of(number)).sum():.0f}"
        name = f"object {number}"
        assert shown == [name, name, f"{total_mn} mN", f"{total_mn} mN", name, total_mn]
        seen.add(number)
        return len(seen) > 9

    page.until(agrees, "the page stands still")


def test_the_history_is_whole_in_a_window_of_1280_by_800(page: Browser, server: Server, hub: Fabric) -> None:
    hub.publish(MARK, Mark(label="cup"))
    page.until(lambda: "Mark" in page.text("#tracks dl"), "no mark")

    def play() -> None:
        server.stop()
        server.actions = {}
        server.live.shows["playback"] = PLAYED
        server.start()
        page.until(lambda: page.ask("document.getElementById('mark').hidden"), "a recording can be marked")

    def is_whole(instant: str) -> bool:
        return instant in page.text("#instant") and page.ask("""document.getElementById("time").getBoundingClientRect()
          .bottom <= 788 && [...document.querySelectorAll("#time .detail, #time dd")]
          .every((each) => each.scrollWidth <= each.clientWidth)""")

    for show, instant in ((lambda: None, "now"), (lambda: press(page, " "), "ago"), (play, " of 1:00.0")):
        show()
        page.until(lambda: is_whole(instant), f"the history of '{instant}' is cut")  # noqa: B023


def test_five_minutes_are_drawn_with_their_gaps(browser: Browser, server: Server) -> None:
    """From two minutes on nothing was measured for one minute; frames were lost at four."""
    moments = np.arange(3000) / 10
    known = [None if 120 <= moment < 180 else True for moment in moments]
    columns: dict[str, list[Any]] = {"time_s": (time.time() - 300 + moments).tolist()}
    for name, value in (
        ("force_n", 1.5),
        ("latency_s", 0.01),
        ("load_ratio", 0.8),
        ("label", "cup"),
        ("contacts", []),
        ("mark", "mug"),
    ):
        columns[name] = [each and value for each in known]
    columns["lost"] = [each and (9 if 240 <= moment < 250 else 0) for each, moment in zip(known, moments, strict=True)]
    script = f"""(() => {{
      const real = fetch, history = {json.dumps(columns)};
      window.fetch = (address, ...more) => String(address).startsWith("api/history")
        ? Promise.resolve(new Response(JSON.stringify(String(address).endsWith("=0") ? history : {{ time_s: [] }})))
        : real(address, ...more);
    }})()"""
    identifier = browser.call("Page.addScriptToEvaluateOnNewDocument", source=script)["identifier"]
    try:
        browser.open(server.address, width=1600)
        browser.until(lambda: "Mark" in browser.text("#tracks"), "no history was drawn")
    finally:
        browser.call("Page.removeScriptToEvaluateOnNewDocument", identifier=identifier)
    names = browser.ask("[...document.querySelectorAll('#tracks dt')].map((each) => each.innerText)")
    assert names == ["Force", "Latency", "Load", "Frames lost", "Label", "Mark"]
    force, latency, lost, label, mark = (0.05, 0.17), (0.25, 0.36), (0.54, 0.63), (0.69, 0.75), (0.81, 0.88)
    assert all(ink(browser, "#scrub canvas", 0.3, track) for track in (force, latency, label, mark))
    assert not any(ink(browser, "#scrub canvas", 0.53, track) for track in (force, latency, lost, label, mark))
    assert ink(browser, "#scrub canvas", 0.81, lost)
    assert not ink(browser, "#scrub canvas", 0.87, lost)


def test_a_recording_is_said_and_moved(page: Browser, server: Server) -> None:
    assert page.ask("document.querySelector('#playing').hidden")
    server.live.shows["playback"] = PLAYED
    server.actions.clear()
    server.actions.update(server.doer.actions("play"))
    page.until(lambda: page.text("#playing") == "RECORDING cup.mcap", "the recording was not said")
    page.until(lambda: page.text("#instant").startswith("0:12.0 of 1:00.0"), "no position")
    page.ask("document.querySelector('#pause').click()")
    page.until(lambda: page.text("#pause") == "Go on", "it was not held")
    page.until(lambda: page.text("#tracks dd") != "", "no history")  # without, nothing there can have the focus
    page.ask("document.querySelector('#scrub').focus()")
    press(page, "ArrowRight")
    page.until(lambda: page.text("#instant").startswith("0:13.0"), "it was not moved")
    press(page, "Home")
    page.until(lambda: page.text("#instant").startswith("0:00.0"), "it was not moved to its begin")
    page.ask("((select) => { select.value = '2'; select.onchange(); })(document.querySelector('#speed select'))")
    page.until(lambda: server.live.shows["playback"].speed == 2.0, "the speed was not set")  # type: ignore[union-attr]


def test_actions_are_asked_for_and_answered(page: Browser, server: Server, chain: Chain) -> None:
    chain.contacts = True
    page.until(lambda: len(rows(page, "contacts")) == 1, "no contact was listed")
    press(page, "t")
    assert "Now something touches the skin: contact 7" in page.text("#taring .advice")
    page.ask("document.querySelector('#taring .do').click()")
    page.until(lambda: "something touches the skin; by force" in page.text("#taring .said.error"), "no refusal")
    page.ask("document.querySelector('#taring .force').click()")
    page.until(lambda: page.text("#taring .said.done") == "done", "no answer")
    page.ask("document.querySelector('#taring .close').click()")
    page.ask("document.querySelector('#mark input').value = 'cup'; document.querySelector('#mark').requestSubmit()")
    page.until(lambda: "nothing is recorded" in page.text("#answer.error"), "the refusal was not shown")
    press(page, "r")
    page.until(lambda: page.text("#record").startswith("Stop 0:0"), "no recording")
    assert page.text("#path") == "recording to palm.mcap"
    page.ask("document.querySelector('#mark').requestSubmit()")
    page.until(lambda: page.ask("document.querySelector('#labels option')?.value") == "cup", "the label was forgotten")
    press(page, "r")
    page.until(lambda: page.text("#record") == "Record", "the recording goes on")
    assert "12 messages" in page.text("#answer.done")
    assert server.doer.asked == [
        Tare(), Tare(force=True), SetMark(label="cup"), Record(on=True), SetMark(label="cup"), Record(on=False),
    ]  # fmt: skip
    page.complaints.clear()  # the browser counts a refusal among them


def test_what_the_server_does_not_allow_is_not_there(browser: Browser, server: Server) -> None:
    server.stop()
    server.actions = {}
    server.start()
    browser.open(server.address)
    browser.until(lambda: "golf ball" in browser.text("#object"), "no label was shown")
    assert browser.ask("['tare', 'record', 'mark'].every((id) => document.getElementById(id).hidden)")
    press(browser, "t")
    assert not browser.ask("document.querySelector('#taring').open")


@pytest.mark.parametrize("scheme", ["dark", "light"])
def test_texts_have_contrast_and_controls_names(page: Browser, chain: Chain, scheme: str) -> None:
    """WCAG 2.2, 1.4.3 and 4.1.2, with every kind of node and notice."""
    chain.gateway = {"nmt": ((5, 255, 127, 4), (0, 5, 5, 5)), "refused": (4,)}
    chain.contacts = chain.doubtful = True
    chain.invalid = (3,)
    page.until(
        lambda: "silent" in page.text("#notices") and "in doubt" in page.text("#contacts"), "no trouble was told"
    )
    while page.ask("document.documentElement.dataset.scheme") != scheme:
        press(page, "d")
    faint = page.ask(CONTRAST)
    assert not faint
    page.ask("document.querySelector('#help').click()")
    assert not page.ask(CONTRAST)
    assert page.ask("document.activeElement.textContent") == "Close"  # no key that is tried there turns anything off
    page.ask("document.querySelector('#keys').close()")
    tree = page.call("Accessibility.getFullAXTree")["nodes"]
    controls = [
        node for node in tree if not node["ignored"] and any(
            each["name"] == "focusable" and each["value"]["value"] for each in node.get("properties", [])
        )
    ]  # fmt: skip
    assert len(controls) > 15
    assert not [node["role"] for node in controls if not node["name"]["value"].strip()]
    page.open(page.ask("location.href"))
    page.until(lambda: "golf ball" in page.text("#object"), "no label was shown")
    assert page.ask("document.documentElement.dataset.scheme") == scheme
    page.ask("localStorage.clear()")


#: Texts whose contrast with what is behind them is too low.
CONTRAST = r"""(() => {
  const brush = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });
  const luminance = (color) => {
    brush.clearRect(0, 0, 1, 1);
    brush.fillStyle = color;
    brush.fillRect(0, 0, 1, 1);
    const [r, g, b] = [...brush.getImageData(0, 0, 1, 1).data].map((value) => value / 255)
      .map((value) => (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const found = [];
  for (const element of document.querySelectorAll("body *")) {
    const hasText = [...element.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
    if (!hasText || !element.checkVisibility() || element.closest(".stale, script, noscript")) continue;
    const { color, fontSize, fontWeight } = getComputedStyle(element);
    let behind = element;
    while (behind && getComputedStyle(behind).backgroundColor === "rgba(0, 0, 0, 0)") behind = behind.parentElement;
    const [one, other] = [luminance(color), luminance(getComputedStyle(behind ?? document.body).backgroundColor)];
    const ratio = (Math.max(one, other) + 0.05) / (Math.min(one, other) + 0.05);
    const isLarge = parseFloat(fontSize) >= 24 || (parseFloat(fontSize) >= 18.66 && fontWeight >= 700);
    if (ratio < (isLarge ? 3 : 4.5)) found.push(`${element.className} ${element.textContent}: ${ratio}`);
  }
  return found;
})()"""


def test_the_keyboard_reaches_all_and_the_focus_is_seen(page: Browser) -> None:
    page.until(lambda: ink(page, "#scrub canvas", 0.999) > 2, "no history was drawn")
    reached, bare = [], []
    for _ in range(40):
        for kind in ("rawKeyDown", "keyUp"):
            page.call("Input.dispatchKeyEvent", type=kind, key="Tab", code="Tab", windowsVirtualKeyCode=9)
        name, outline = page.ask("""(({ activeElement: at }) => {
          const seen = at.matches(".choice input") ? at.nextElementSibling : at;
          return [at.id || at.closest("[id]")?.id || at.tagName, getComputedStyle(seen).outlineStyle];
        })(document)""")
        reached.append(name)
        if name != "BODY" and outline == "none":
            bare.append(name)
        if name == "BODY":
            break
    wanted = ["scheme", "help", "scaling", "pause", "mark", "record", "scrub", "tare", "contacts", "buses"]
    assert [name for name in dict.fromkeys(reached) if name in wanted] == wanted
    assert not bare


REGIONS = [
    {"name": "heel", "box": [0, 0, 15, 7], "threshold_n": 0.05},
    {"name": "toe", "box": [0, 8, 15, 15]},
]


@pytest.mark.parametrize("messages", [{"region": REGIONS}], indirect=True)
def test_a_region_over_its_threshold_is_marked(page: Browser) -> None:
    page.until(lambda: len(rows(page, "regions")) == 2, "no regions")
    heel, toe = rows(page, "regions")
    assert [heel[0], heel[3], toe[0], toe[3]] == ["heel", "over 50.0 mN", "toe", ""]
    assert page.ask("[...document.querySelectorAll('#regions tr.over')].map((row) => row.cells[0].innerText)") == [
        "heel"
    ]
    assert "on heel: more than its threshold of 0.05 N" in page.text("#notices")
    press(page, "t")
    assert page.ask("[...document.querySelectorAll('#taring option')].map((each) => each.text)") == [
        "whole skin", "heel", "toe",
    ]  # fmt: skip


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


def test_a_node_says_since_when_and_why(page: Browser, chain: Chain) -> None:
    told = tuple(NodeEmergency(node, 0x8130 + node, 0) for node in (1, 2, 2, 2))
    chain.gateway = {"nmt": ((5, 255, 5, 5), (5, 5, 5, 5)), "emergencies": told}
    page.until(lambda: "node 2 silent" in page.text("#notices"), "no notice")
    page.ask("document.querySelector('#buses .tile').focus()")
    press(page, "ArrowRight")
    page.until(lambda: "node 2 silent since" in page.text("#buses .detail"), "the keyboard does not reach the node")
    assert re.search(r"node 2 silent since \d\d:\d\d:\d\d, [\d.]+ s", page.text("#buses .detail"))
    assert re.search(r"( · EMCY 8132h at \d\d:\d\d:\d\d){2}$", page.text("#buses .detail"))
    assert page.ask("document.activeElement.ariaLabel").startswith("left, node 2: silent since ")
    page.ask("document.activeElement.blur()")
    page.until(lambda: page.text("#buses .detail") == "3 of 4 nodes operational", "the sum did not come back")


def test_images_that_stop_are_marked_and_explained(page: Browser, chain: Chain) -> None:
    chain.images = False
    chain.reconstructor.close()
    page.until(lambda: "images stopped: reconstructor is gone (since" in page.text("#notices"), "no notice")
    assert "stale" in page.text("#map-image .veil")
    # The true image is of the cycle of the reconstructed one, and as old.
    stale = "[...document.querySelectorAll('figure')].every((each) => each.classList.contains('stale'))"
    page.until(lambda: page.ask(stale), "an old image is shown as new")


def test_without_truth_only_the_image_is_there(page: Browser, chain: Chain) -> None:
    page.until(lambda: not page.ask("document.querySelector('#map-true').hidden"), "no true image")
    chain.truths = False
    page.until(lambda: page.ask("document.querySelector('#map-true').hidden"), "the true image stayed")
    page.until(lambda: page.ask("document.querySelector('#psnr').hidden"), "the PSNR stayed")
    assert page.ask("document.querySelector('#map-sensor').hidden")


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


def test_page_fits_every_window(page: Browser, chain: Chain) -> None:
    chain.contacts = True
    chain.gateway = {"links": ("lost", "active"), "troubles": (LOST, "")}
    for width in (320, 390, 480, 700, 999, 1000, 1280, 1700, 2560):
        size = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": False}
        page.call("Emulation.setDeviceMetricsOverride", **size)
        image = "document.querySelector('#map-image canvas')"
        fits = [
            f"document.documentElement.scrollWidth <= {width}",
            f"{image}.width % 16 === 0",
            f"{image}.clientWidth >= {min(320, width * 0.9)}",
            # Of a phone's width the image takes all.
            f"{width} > 480 || {image}.clientWidth === {width} - 24",
        ]
        page.until(lambda: page.ask(" && ".join(fits)), f"expected {fits}")  # noqa: B023


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
    browser.open(server.address, width=380)
    browser.until(lambda: "1 missing within 1 s" in browser.text("#blocks"), "the missing block was not told")
    assert browser.ask(
        "[...document.querySelectorAll('.detail')].every((line) => line.scrollWidth <= line.clientWidth)"
    )


def test_the_token_leaves_the_address_and_without_it_a_page_only_shows(page: Browser, server: Server) -> None:
    assert page.ask("location.href + document.cookie") == f"http://127.0.0.1:{server.port}/"
    page.open(f"http://localhost:{server.port}/")  # a host without a cookie
    page.until(lambda: "golf ball" in page.text("#object"), "no label was shown")
    page.ask("document.querySelector('#record').click()")
    page.until(lambda: "expected the page's token" in page.text("#answer"), "it was not refused")
    assert server.doer.asked == []

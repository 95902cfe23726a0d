// The page: takes frames from the connection, and draws the newest, or that of the past, once per screen refresh.

import { Actions, Answer, ask, drawPlaying } from "./actions.js";
import { Buses } from "./buses.js";
import { Contacts, Regions } from "./contacts.js";
import { Figures } from "./figures.js";
import { History } from "./history.js";
import { Images } from "./images.js";
import { listen } from "./keys.js";
import { drawNotices, drawServices } from "./notices.js";
import { Connection, parse } from "./socket.js";
import { Timeline } from "./timeline.js";
import { clockTenths, write } from "./words.js";

// Frames come 25 times a second. Without frames for this long, the page is stale.
const LOST_MS = 1000;
// A true image is missing in a frame or two when it comes late; its place stays for this time.
const TRUTH_S = 3;

let skin = null;
let parts = null; // what draws the skin
let frame = null; // the newest
let isDue = false;
let lastFrameTime = Date.now();
let truthAt_s = -Infinity; // time of the newest frame with a true image

const answer = new Answer();
const history = new History(() => {
  timeline.drawTracks();
  parts?.contacts.drawCurves();
});
const timeline = new Timeline(history, { show: schedule, fetchFrame, play });

async function fetchFrame(time_s) {
  try {
    const found = await fetch(`api/frame?time_s=${time_s}`);
    return found.ok ? parse(await found.arrayBuffer(), skin.rows * skin.columns) : null;
  } catch {
    return null;
  }
}

async function play(request) {
  const said = await ask("play", request);
  if (!said.isDone) answer.say(said);
}

function setSkin(greeting) {
  if (JSON.stringify(greeting) === JSON.stringify(skin)) return;
  skin = greeting;
  frame = null;
  truthAt_s = -Infinity;
  history.clear();
  timeline.past = null;
  const buses = new Buses(greeting, (block) => parts.images.pointBlock(block));
  parts = {
    buses,
    images: new Images(greeting, buses, schedule),
    figures: new Figures(greeting),
    contacts: new Contacts(greeting, history),
    regions: new Regions(greeting),
    actions: new Actions(greeting, answer),
  };
  document.title = `${greeting.skin} – canskin`;
  const { rows, columns, blocks, sums, block_of_taxel, surface } = greeting;
  const there = block_of_taxel.filter((block) => block >= 0).length;
  const taxels = surface || there < rows * columns ? there : `${rows} × ${columns}`;
  const inSteps = greeting.sending === "steps";
  write(document.getElementById("skin"), `${greeting.skin} · ${taxels} taxels · ${blocks} blocks · ${sums} sums${inSteps ? " in steps" : " a cycle"}`);
  write(document.querySelector("#latency h2"), `${inSteps ? "Frame" : "SYNC"} to image, median`);
}

function schedule() {
  if (isDue) return;
  isDue = true;
  requestAnimationFrame(() => {
    isDue = false;
    draw();
  });
}

function draw() {
  const isLost = connection.silence() > LOST_MS;
  document.body.classList.toggle("unconnected", isLost);
  if (isLost) {
    const text = frame ? "connection to the viewer is lost; trying again" : "connecting to the viewer";
    drawNotices([{ level: frame ? "error" : "info", text, since_time_s: frame ? lastFrameTime / 1000 : null }], Date.now() / 1000);
  }
  if (!frame) return;
  const { snapshot } = frame;
  const { past } = timeline;
  const shown = past?.frame ?? frame;
  if (shown.snapshot.truth) truthAt_s = shown.snapshot.time_s;
  const hasTruth = Math.abs(shown.snapshot.time_s - truthAt_s) < TRUTH_S;
  if (!isLost) drawNews(snapshot);
  if (past || !isLost) drawInstant(shown.snapshot, hasTruth);
  const veil = past?.isMissing ? "no picture of this instant" : isLost && !past ? "stale: connection lost" : "";
  parts.images.draw(shown, hasTruth, veil, past ? `the past: ${clockTenths(timeline.shown_s)}` : "");
}

/** Draw what is of now, whatever instant is shown. */
function drawNews(snapshot) {
  drawNotices(snapshot.notices, snapshot.time_s);
  drawServices(snapshot);
  drawPlaying(snapshot);
  timeline.draw(snapshot);
  parts.actions.draw(snapshot);
}

/** Draw what belongs to one instant. */
function drawInstant(snapshot, hasTruth) {
  timeline.drawValues(snapshot);
  parts.figures.draw(snapshot, hasTruth);
  parts.contacts.draw(snapshot);
  parts.regions.draw(snapshot);
  parts.buses.draw(snapshot);
}

// The server has set a cookie: its token is not to stay in the address.
if (location.search) window.history.replaceState(null, "", location.pathname);
const connection = new Connection(setSkin, (newest) => {
  frame = history.frame = newest;
  lastFrameTime = Date.now();
  schedule();
});
setInterval(schedule, 250);
addEventListener("resize", schedule);
addEventListener("schemechange", () => {
  timeline.drawTracks();
  parts?.contacts.drawCurves();
  schedule();
});
listen({
  toggle: () => timeline.toggle(),
  live: () => timeline.goLive(),
  step: (seconds) => timeline.step(seconds),
  record: () => parts?.actions.record(),
  mark: () => document.querySelector("#mark input").focus(),
  tare: () => parts?.actions.allows("tare") && parts.actions.tare.open(),
  scale: () => document.querySelector("#scaling input:not(:checked)").click(),
  scheme: () => document.getElementById("scheme").click(),
  close: () => answer.close(),
});

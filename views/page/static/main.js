// The page: takes frames from the connection and draws the newest once per screen refresh.

import { Buses } from "./buses.js";
import { drawFigures } from "./figures.js";
import { Images } from "./images.js";
import { drawNotices, drawServices } from "./notices.js";
import { Connection } from "./socket.js";
import { write } from "./words.js";

// Frames come 25 times a second. Without frames for this long, the page is stale.
const LOST_MS = 1000;

let skin = "";
let images = null;
let buses = null;
let frame = null;
let isDue = false;
let lastFrameTime = Date.now();

function setSkin(greeting) {
  const content = JSON.stringify(greeting);
  if (content === skin) return;
  skin = content;
  frame = null;
  buses = new Buses(greeting, (block) => images.pointBlock(block));
  images = new Images(greeting, buses, schedule);
  document.title = `${greeting.skin} – canskin`;
  const { rows, columns, blocks, sums, block_of_taxel, surface } = greeting;
  const there = block_of_taxel.filter((block) => block >= 0).length;
  const taxels = surface || there < rows * columns ? there : `${rows} × ${columns}`;
  const isAdaptive = greeting.sending === "adaptive";
  write(document.getElementById("skin"), `${greeting.skin} · ${taxels} taxels · ${blocks} blocks · ${sums} sums${isAdaptive ? ", sent when they have news" : " a cycle"}`);
  write(document.querySelector("#latency h2"), `${isAdaptive ? "Frame" : "SYNC"} to image, median`);
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
  if (!isLost) {
    drawNotices(snapshot.notices, snapshot.time_s);
    drawServices(snapshot);
    drawFigures(snapshot);
    buses.draw(snapshot.gateway);
  }
  images.draw(frame, isLost ? "stale: connection lost" : "");
}

const connection = new Connection(setSkin, (newest) => {
  frame = newest;
  lastFrameTime = Date.now();
  schedule();
});
setInterval(schedule, 250);

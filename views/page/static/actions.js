// What the page asks the server for: tare, record and mark. The server says what was done, or why it was refused.

import { touching } from "./contacts.js";
import { keep, kept } from "./kept.js";
import { force, stopwatch, write } from "./words.js";

const MOST_LABELS = 12;
// Time that an answer stays; a refusal stays until it is closed.
const SHOWN_MS = 8000;

/** Ask the server for an action; returns whether it was done, and what the server says. */
export async function ask(name, request) {
  try {
    const answer = await fetch(`api/${name}`, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(request) });
    const said = await answer.text();
    const isJson = answer.headers.get("Content-Type")?.startsWith("application/json");
    const { text, error } = isJson ? JSON.parse(said) : { error: said };
    return { isDone: answer.ok, text: text ?? error ?? "" };
  } catch {
    return { isDone: false, text: "no answer: the connection to the viewer is lost" };
  }
}

export class Answer {
  constructor() {
    this.root = document.getElementById("answer");
    this.root.querySelector("button").onclick = () => this.close();
  }

  say({ isDone, text }) {
    clearTimeout(this.timer);
    this.root.hidden = false;
    this.root.className = isDone ? "done" : "error";
    write(this.root.querySelector("span"), text);
    if (isDone) this.timer = setTimeout(() => this.close(), SHOWN_MS);
  }

  close() {
    this.root.hidden = true;
  }
}

export class Actions {
  constructor(skin, answer) {
    this.answer = answer;
    this.skin = skin;
    this.recorder = null;
    const part = (id) => document.getElementById(id);
    [this.tareButton, this.recordButton, this.form, this.path] = ["tare", "record", "mark", "path"].map(part);
    this.recordButton.onclick = () => this.record();
    this.form.onsubmit = (event) => {
      event.preventDefault();
      this.mark();
    };
    this.offerLabels();
    this.tare = new Tare(skin, answer);
    this.tareButton.onclick = () => this.tare.open();
  }

  allows(name) {
    return this.skin.actions.includes(name);
  }

  draw(snapshot) {
    this.tareButton.hidden = !this.allows("tare");
    this.recordButton.hidden = !this.allows("record");
    this.form.hidden = !this.allows("mark");
    this.tare.snapshot = snapshot;
    const { recorder, time_s } = snapshot;
    this.recorder = recorder;
    this.recordButton.classList.toggle("on", Boolean(recorder));
    const text = this.recordButton.lastElementChild;
    if (!this.isAsking) write(text, recorder ? `Stop ${stopwatch(Math.max(0, time_s - recorder.since_time_s))}` : "Record");
    write(this.path, recorder ? `recording to ${recorder.path}` : "");
    this.path.title = recorder?.path ?? "";
  }

  async record() {
    if (this.isAsking || !this.allows("record")) return;
    const on = !this.recorder;
    this.isAsking = true;
    write(this.recordButton.lastElementChild, on ? "starting…" : "stopping…");
    this.answer.say(await ask("record", { on }));
    this.isAsking = false;
  }

  async mark() {
    const { label } = this.form.elements;
    const text = label.value.trim();
    const said = await ask("mark", { label: text });
    this.answer.say(said);
    if (!said.isDone) return;
    label.value = "";
    const labels = [text, ...this.labels().filter((each) => each !== text)].filter(Boolean);
    keep("labels", JSON.stringify(labels.slice(0, MOST_LABELS)));
    this.offerLabels();
  }

  labels() {
    try {
      return JSON.parse(kept("labels") ?? "[]");
    } catch {
      return [];
    }
  }

  offerLabels() {
    document.getElementById("labels").replaceChildren(...this.labels().map((label) => new Option(label)));
  }
}

/** The dialog that measures the zero. */
class Tare {
  constructor(skin, answer) {
    this.answer = answer;
    this.dialog = document.getElementById("taring");
    const find = (selector) => this.dialog.querySelector(selector);
    [this.where, this.advice, this.said, this.button, this.byForce] = ["select", ".advice", ".said", ".do", ".force"].map(find);
    this.where.replaceChildren(new Option("whole skin", ""), ...skin.regions.map((name) => new Option(name)));
    this.where.parentElement.hidden = !skin.regions.length;
    this.where.onchange = () => this.advise();
    this.button.onclick = () => this.ask(false);
    this.byForce.onclick = () => this.ask(true);
    find(".close").onclick = () => this.dialog.close();
    this.snapshot = null;
  }

  open() {
    if (this.dialog.open) return;
    write(this.said, "");
    this.advise();
    this.dialog.showModal();
    this.button.focus();
  }

  /** Say what a tare needs, and what touches the skin now. */
  advise() {
    const contacts = this.snapshot ? touching(this.snapshot) : [];
    const now = contacts.map(({ identity, force_n }) => `contact ${identity} (${force(force_n)})`).join(", ");
    const isRegion = this.where.value !== "";
    const rule = isRegion ? "Whatever stands on the region becomes part of its zero." : "Nothing may touch the skin for 2 s.";
    write(this.advice, contacts.length ? `${rule} Now something touches the skin: ${now}.` : rule);
    this.byForce.hidden = isRegion || !contacts.length;
    this.byForce.title = "what touches the skin becomes part of the zero";
    write(this.button, contacts.length && !isRegion ? "Try without force" : "Tare");
  }

  async ask(isForced) {
    const buttons = [this.button, this.byForce];
    for (const each of buttons) each.disabled = true;
    this.said.className = "said";
    write(this.said, "measuring the zero…");
    const said = await ask("tare", { region: this.where.value || null, force: isForced });
    for (const each of buttons) each.disabled = false;
    this.said.className = `said ${said.isDone ? "done" : "error"}`;
    write(this.said, said.text);
    if (!this.dialog.open) this.answer.say(said);
    this.byForce.hidden = said.isDone || this.where.value !== "";
  }
}

/** Text of a recording that is played. */
export function drawPlaying({ playback }) {
  const root = document.getElementById("playing");
  root.hidden = !playback;
  if (playback) write(root.querySelector("span"), playback.path.split("/").at(-1));
}

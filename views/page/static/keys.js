// The keys of the page, and the dialog that lists them.

import { make } from "./words.js";

const CHOICE = "canskin.keys";
const dialog = document.getElementById("keys");
const box = dialog.querySelector("input");

/** The keys do what `deeds` has under their names. */
export function listen(deeds) {
  const keys = [
    [[" "], "Space", "pause, go on", deeds.toggle],
    [["l"], "L", "live again", deeds.live],
    [["ArrowLeft", "ArrowRight"], "← →", "one second back, on; with Shift ten", (event) => deeds.step((event.key === "ArrowLeft" ? -1 : 1) * (event.shiftKey ? 10 : 1))],
    [[",", "."], ", .", "a tenth of a second back, on", (event) => deeds.step(event.key === "," ? -0.1 : 0.1)],
    [["Home", "End"], "Home End", "on the history: its begin, its end; on a skin in space: Home turns it back", null],
    [["r"], "R", "start, stop a recording", deeds.record],
    [["m"], "M", "mark what touches", deeds.mark],
    [["t"], "T", "tare", deeds.tare],
    [["c"], "C", "colour scale fixed, auto", deeds.scale],
    [["d"], "D", "dark, light", deeds.scheme],
    [["?"], "?", "this list", open],
    [["Escape"], "Esc", "closes answers and dialogs", deeds.close],
    [[], "Tab, arrows", "on the nodes of a bus: which node, since when, why; on a skin in space: turn it", null],
  ];
  const rows = keys.map(([, shown, text]) => {
    const row = make("div");
    row.append(make("dt", "", shown), make("dd", "", text));
    return row;
  });
  dialog.querySelector("dl").replaceChildren(...rows);
  addEventListener("keydown", (event) => {
    const found = keys.find(([names, , , act]) => act && names.includes(event.key.length === 1 ? event.key.toLowerCase() : event.key));
    if (!found || event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey || isTaken(event)) return;
    event.preventDefault();
    found[3](event);
  });
}

/** Whether the key belongs to what has the focus, or keys of one letter are off. */
function isTaken({ key, target }) {
  if (document.querySelector("dialog[open]") || target.matches("select, input:not([type=radio])")) return true;
  if (/^[a-z,.]$/i.test(key) && !box.checked) return true;
  return target.matches("button, input") && (key === " " || key.startsWith("Arrow"));
}

function open() {
  if (!dialog.open) dialog.showModal();
}

box.checked = localStorage.getItem(CHOICE) !== "off";
box.onchange = () => localStorage.setItem(CHOICE, box.checked ? "on" : "off");
dialog.querySelector(".close").onclick = () => dialog.close();
document.getElementById("help").onclick = open;

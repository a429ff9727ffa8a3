// Buttons and keys: each calls one thing that main.js lets be done.

import { RATES } from "./timeline.js";

// The keys, what they do, and what the page must have for that.
const KEYS = [
  ["Space", "play or pause"],
  [", .", "previous, next decision", "decisions"],
  ["← →", "one second back, on; with Shift ten"],
  ["J K", "previous, next mark", "marks"],
  ["Home End", "to the start, to the end"],
  ["1 … 7", "speed: 0.25 0.5 1 2 4 8 16"],
  ["F", "follow, or leave the view where it is"],
  ["L", "rays: what the host senses", "rays"],
  ["N", "names"],
  ["+ −", "zoom in, out"],
  ["0", "show the whole road"],
  ["S", "save the view as a picture"],
  ["R", "record a film of the view", "recorder"],
  ["D", "light or dark"],
  ["?", "these keys"],
];

const ZOOM = 1.35;

/** The keys that do something, with what they do. `has` tells what the page has, as {decisions: true}. */
export function keysOf(has) {
  return KEYS.filter(([, , needed]) => !needed || has[needed]).map(([keys, meaning]) => [keys, meaning]);
}

/** What a key does, by its name; null where it does nothing. */
export function commandOf(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return null;
  const far = event.shiftKey ? 10 : 1;
  const { key } = event;
  if (/^[1-7]$/.test(key)) return ["rate", RATES[Number(key) - 1]];
  const commands = {
    " ": ["toggle", "playing"],
    ",": ["decision", -1],
    ".": ["decision", 1],
    ArrowLeft: ["skip", -far],
    ArrowRight: ["skip", far],
    Home: ["seek", 0],
    End: ["seek", Infinity],
    j: ["mark", -1],
    k: ["mark", 1],
    f: ["toggle", "follows"],
    l: ["toggle", "rays"],
    n: ["toggle", "names"],
    "+": ["zoom", ZOOM],
    "=": ["zoom", ZOOM],
    "-": ["zoom", 1 / ZOOM],
    _: ["zoom", 1 / ZOOM],
    0: ["whole"],
    s: ["picture"],
    r: ["record"],
    d: ["theme"],
    "?": ["help"],
  };
  const name = key.length === 1 ? key.toLowerCase() : key;
  return Object.hasOwn(commands, name) ? commands[name] : null;
}

const BUTTONS = {
  play: ["toggle", "playing"],
  "previous-decision": ["decision", -1],
  "next-decision": ["decision", 1],
  "previous-mark": ["mark", -1],
  "next-mark": ["mark", 1],
  follow: ["toggle", "follows"],
  rays: ["toggle", "rays"],
  names: ["toggle", "names"],
  "zoom-in": ["zoom", ZOOM],
  "zoom-out": ["zoom", 1 / ZOOM],
  whole: ["whole"],
  "save-picture": ["picture"],
  record: ["record"],
  theme: ["theme"],
  help: ["help"],
};

/** Let buttons and keys act, and show those that do something. `act(name, value)` does it. */
export function listen(act, has) {
  for (const element of document.querySelectorAll("[data-needs]")) element.hidden = !has[element.dataset.needs];
  for (const [id, command] of Object.entries(BUTTONS)) {
    document.getElementById(id).addEventListener("click", () => act(...command));
  }
  for (const button of document.querySelectorAll(".begin")) button.addEventListener("click", () => act("toggle", "playing"));
  const rate = document.getElementById("rate");
  rate.append(...RATES.map((value) => new Option(`${value}×`, value)));
  rate.addEventListener("change", () => act("rate", Number(rate.value)));
  rate.addEventListener("change", () => rate.blur()); // so that keys act on the film again
  document.addEventListener("click", ({ target, detail }) => {
    if (detail > 0 && target instanceof Element) target.closest("button")?.blur(); // else Space would press it once more
  });
  document.addEventListener("keydown", (event) => {
    const dialog = document.getElementById("keys");
    if (dialog.open && event.key !== "?") return;
    const isTyping = event.target instanceof HTMLSelectElement;
    const presses = event.key === " " && event.target instanceof HTMLElement && event.target.matches("button, summary");
    const command = isTyping || presses ? null : commandOf(event);
    if (!command) return;
    event.preventDefault();
    act(...command);
  });
  const list = document.querySelector("#keys dl");
  for (const [keys, meaning] of keysOf(has)) {
    const term = document.createElement("dt");
    for (const key of keys.split(" ")) {
      const shown = document.createElement("kbd");
      shown.textContent = key;
      term.append(key === "…" ? key : shown, " ");
    }
    const description = document.createElement("dd");
    description.textContent = meaning;
    list.append(term, description);
  }
}

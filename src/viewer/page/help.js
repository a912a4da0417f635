// Keys, and the sheet that lists them.

import * as edits from "./edits.js";
import { el, find, icon } from "./dom.js";
import { showAll, toggleHidden, toggleIsolated } from "./panel.js";
import { addKey } from "./renders.js";
import { select, selection, state, tell } from "./store.js";

const COLOURS = /** @type {const} */ (["photo", "instance", "confidence", "origin"]);

/** @param {import("./store.js").Tool} tool */
export function useTool(tool) {
  state.tool = state.tool === tool ? "look" : tool;
  tell("view");
}

/** @param {"cameras" | "strip" | "behind"} what */
export function toggle(what) {
  state[what] = !state[what];
  tell("view");
}

/** Stands at the photo before or after the one that one stands at.
 * @param {import("./camera.js").View} view @param {number} step */
function nextPhoto(view, step) {
  const cameras = (state.scene?.photos ?? []).map(({ camera }) => camera);
  if (cameras.length === 0) return;
  const here = view.photo ? cameras.indexOf(view.photo) : step > 0 ? -1 : 0;
  view.standAt(cameras[(here + step + cameras.length) % cameras.length]);
}

/** What each key does, by what it is called. @param {import("./camera.js").View} view
 * @returns {Record<string, [string, () => unknown]>} */
const keys = (view) => ({
  "1": ["Turn around the room", () => view.setMode("orbit")],
  "2": ["Walk through the room (W A S D, Q and E for down and up)", () => view.setMode("fly")],
  "3": ["The room as a map", () => view.setMode("top")],
  "0": ["See all of the room", () => state.scene && view.home(state.scene)],
  "]": ["Stand at the next photo", () => nextPhoto(view, 1)],
  "[": ["Stand at the photo before", () => nextPhoto(view, -1)],
  c: ["Other colours", () => { state.colours = COLOURS[(COLOURS.indexOf(state.colours) + 1) % 4]; tell("view"); }],
  v: ["Show or hide cameras", () => toggle("cameras")],
  p: ["Show or hide the photo strip", () => toggle("strip")],
  b: ["Show or leave out what is seen from behind, as walls are from outside", () => toggle("behind")],
  f: ["Look at what is selected", () => selection()[0] && view.lookAt(selection()[0].floor_box)],
  h: ["Hide or show what is selected", () => toggleHidden()],
  i: ["Isolate what is selected", toggleIsolated],
  "shift+h": ["Show everything", showAll],
  x: ["Remove what is selected", edits.remove],
  g: ["Move along the floor, with the pointer", () => useTool("move")],
  "shift+d": ["Duplicate", edits.duplicate],
  m: ["Merge what is selected into the first", edits.merge],
  l: ["Split with a lasso", () => useTool("lasso")],
  n: ["Name what is selected", () => find("#rename")?.select()],
  k: ["Add this view to the camera path", addKey],
  "ctrl+z": ["Undo", edits.undo],
  "ctrl+shift+z": ["Redo", edits.redo],
  escape: ["Select nothing", () => { state.tool = "look"; select(null); tell("view"); }],
  "?": ["This sheet", openSheet],
});

/** @param {import("./camera.js").View} view @param {import("./controls.js").Controls} controls */
export function listenToKeys(view, controls) {
  const table = keys(view);
  addEventListener("keydown", (event) => {
    const target = /** @type {HTMLElement} */ (event.target);
    if (find("dialog[open]") || target.closest("input:not([type=range]), select, textarea")) return;
    const key = event.key.toLowerCase();
    const command = event.ctrlKey || event.metaKey;
    const shift = event.shiftKey && (command || /^[a-z]$/.test(key));
    const name = `${command ? "ctrl+" : ""}${shift ? "shift+" : ""}${key === "delete" || key === "backspace" ? "x" : key}`;
    if (state.mode === "fly" && !command && !shift && "wasdqe".includes(key) && key.length === 1) {
      controls.keys.add(key);
      return;
    }
    if (!table[name] || event.altKey) return;
    event.preventDefault();
    table[name][1]();
  });
  addEventListener("keyup", (event) => controls.keys.delete(event.key.toLowerCase()));
  find("#help").addEventListener("click", openSheet);
}

function openSheet() {
  const sheet = find("#sheet");
  const pretty = (/** @type {string} */ name) => name.split("+").map((part) =>
    el("kbd", {}, part.length > 1 ? part[0].toUpperCase() + part.slice(1) : part.toUpperCase()));
  const rows = Object.entries(keys(/** @type {any} */ (null))).flatMap(([name, [words]]) => [
    el("dt", {}, ...pretty(name)), el("dd", {}, words)]);
  sheet.replaceChildren(
    el("header", {}, el("h2", {}, "Keys and gestures"),
      el("button", { class: "tool", "aria-label": "Close", onclick: () => sheet.close() }, icon("close"))),
    el("p", {}, "Drag to turn, with Shift or the right button to shift, wheel to go nearer. With fingers: one turns, two shift and pinch. " +
      "Click an object to select it, with Shift several; double-click to turn around a place. From above, drag what is selected to move it."),
    el("dl", { class: "keys" }, ...rows));
  sheet.showModal();
}

// The side panel: objects, what can be done to them, and what has been done.

import * as edits from "./edits.js";
import { offline } from "./api.js";
import { el, find, icon, readable } from "./dom.js";
import { instance, isShown, select, selection, state, tell } from "./store.js";

let sought = "";

/** @param {number[]} colour */
const css = (colour) => `rgb(${colour.join(" ")})`;
/** @param {number[]} colour */
const hex = (colour) => `#${colour.map((c) => c.toString(16).padStart(2, "0")).join("")}`;

/** @param {number[]} colour */
function swatch(colour) {
  const dot = el("i", { class: "swatch" });
  dot.style.background = css(colour);
  return dot;
}

/** Hides what is selected, or shows it again. @param {number[]} ids */
export function toggleHidden(ids = [...state.selected]) {
  const hide = ids.some(isShown);
  for (const id of ids) {
    if (hide) state.hidden.add(id);
    else {
      state.hidden.delete(id);
      state.isolated?.add(id);
    }
  }
  tell("selection");
}

/** Shows what is selected alone, or everything again. */
export function toggleIsolated() {
  state.isolated = state.isolated || state.selected.size === 0 ? null : new Set(state.selected);
  tell("selection");
}

export function showAll() {
  state.hidden.clear();
  state.isolated = null;
  tell("selection");
}

/** @param {import("./placing.js").Placing} placing @param {import("./camera.js").View} view */
export function fillObjects(placing, view) {
  const { scene } = state;
  if (!scene) return;
  const search = el("input", { type: "search", placeholder: "Find an object", "aria-label": "Find an object", value: sought,
    oninput: (/** @type {any} */ event) => {
      sought = event.target.value.trim().toLowerCase();
      list.replaceChildren(...rows());
    } });
  const rows = () => scene.instances
    .filter(({ name, id }) => name.toLowerCase().includes(sought) || String(id) === sought)
    .map((one) => {
      const shown = isShown(one.id);
      return el("li", { class: shown ? "" : "unseen" },
        el("button", { class: "row", "aria-pressed": state.selected.has(one.id), "data-instance": one.id,
          onclick: (/** @type {MouseEvent} */ event) => select(one.id, event.shiftKey || event.ctrlKey || event.metaKey),
          ondblclick: () => view.lookAt(one.floor_box) },
          swatch(one.colour), el("span", {}, one.name), el("small", {}, readable(one.points))),
        el("button", { class: "tool", "aria-label": shown ? `Hide ${one.name}` : `Show ${one.name}`, title: shown ? "Hide" : "Show",
          onclick: () => toggleHidden([one.id]) }, icon(shown ? "eye" : "hidden")));
    });
  const list = el("ul", { class: "list" }, ...rows());
  const nothing = scene.instances.length === 0 && el("p", { class: "quiet-note" },
    scene.not_editable ?? "There is no object left. Undo brings back what was removed.");
  const partly = (state.isolated || state.hidden.size > 0) &&
    el("button", { class: "wide", onclick: showAll }, "Show everything");
  const link = (/** @type {string} */ format, /** @type {string} */ text) =>
    el("a", { class: "button", href: `/api/export/${format}`, download: "" }, text);
  const exports = el("details", { class: "exports online" }, el("summary", {}, "Export"),
    el("div", { class: "actions" }, link("ply", "Points (PLY)"), link("glb", "Model (GLB)"), link("html", "Page (HTML)"), link("cameras", "Cameras")));
  const scrolled = find("#objects .list")?.scrollTop ?? 0;
  find("#objects").replaceChildren(card(placing, view) || el("p", { class: "quiet-note" },
    "Click an object in the room or in this list. With Shift, several."), search, ...(nothing ? [nothing] : [list]), ...(partly ? [partly] : []), exports);
  list.scrollTop = scrolled;
}

/** What is selected, and what can be done to it.
 * @param {import("./placing.js").Placing} placing @param {import("./camera.js").View} view */
function card(placing, view) {
  const chosen = selection();
  const [one] = chosen;
  if (!one) return null;
  const unit = state.scene?.scale === "metric" ? " m" : "";
  const head = chosen.length > 1
    ? el("h2", {}, `${chosen.length} objects`)
    : el("form", { class: "naming", onsubmit: (/** @type {Event} */ event) => { event.preventDefault(); find("#rename").blur(); } },
      swatch(one.colour),
      el("input", { id: "rename", value: one.name, readonly: offline, "aria-label": "Name", autocomplete: "off", maxlength: 80,
        onchange: (/** @type {any} */ event) => event.target.value.trim() !== one.name && rename(one, event.target) }));
  const facts = chosen.length > 1
    ? el("p", { class: "facts" }, chosen.map(({ name }) => name).join(", "))
    : el("dl", { class: "facts" },
      el("dt", {}, "Id"), el("dd", {}, `${one.id}`),
      el("dt", {}, "Size"), el("dd", {}, `${one.size.map((side) => side.toFixed(2)).join(" × ")}${unit}`),
      el("dt", {}, "Points"), el("dd", {}, readable(one.points)),
      el("dt", {}, "Agreement"), el("dd", {}, `${Math.round(100 * one.score)} %`),
      el("dt", {}, "Photos"), el("dd", { class: "links" }, ...one.photos.map((name) => el("button", { class: "link",
        title: "Stand there", onclick: () => stand(view, name) }, name))));
  const action = (/** @type {string} */ id, /** @type {string} */ text, /** @type {() => void} */ onclick, key = "") =>
    el("button", { id: `do-${id}`, onclick, class: ["hide", "isolate", "look"].includes(id) ? "" : "online", title: key && `${text} (${key})`, disabled: state.busy }, text);
  return el("div", { class: "card" }, head, facts,
    el("div", { class: "actions" },
      action("hide", chosen.every(({ id }) => isShown(id)) ? "Hide" : "Show", () => toggleHidden(), "H"),
      action("isolate", state.isolated ? "Show all" : "Isolate", toggleIsolated, "I"),
      action("look", "Look at", () => view.lookAt(one.floor_box), "F"),
      action("remove", "Remove", edits.remove, "X"),
      action("keep", "Keep only", edits.keepOnly),
      chosen.length > 1 && action("merge", "Merge", edits.merge, "M"),
      chosen.length === 1 && action("duplicate", "Duplicate", edits.duplicate, "Shift D"),
      recolouring(one)),
    chosen.length === 1 && more(one, placing));
}

/** @param {import("./store.js").Instance} one @param {HTMLInputElement} field */
async function rename(one, field) {
  if (!(await edits.rename(one.id, field.value))) field.value = one.name;
}

/** @param {import("./camera.js").View} view @param {string} name */
function stand(view, name) {
  const photo = state.scene?.photos.find((known) => known.name === name);
  if (photo) view.standAt(photo.camera);
}

/** @param {import("./store.js").Instance} one */
function recolouring(one) {
  return el("label", { class: "button online" }, "Recolour",
    el("input", { type: "color", id: "colour", value: hex(one.mean_colour), "aria-label": "New colour", disabled: state.busy,
      onchange: (/** @type {any} */ event) => edits.recolour(event.target.value) }));
}

/** Turning, scaling, splitting. @param {import("./store.js").Instance} one @param {import("./placing.js").Placing} placing */
function more(one, placing) {
  /** @param {string} id @param {string} label @param {Record<string, number>} range @param {(value: number) => any} placement
   * @param {(value: number) => string} words */
  const slider = (id, label, range, placement, words) => {
    const value = el("output", {}, words(range.value));
    return el("label", { class: "slider" }, el("span", {}, label),
      el("input", { type: "range", id, ...range, disabled: state.busy,
        oninput: (/** @type {any} */ event) => {
          value.textContent = words(Number(event.target.value));
          placing.preview(one, placement(Number(event.target.value)));
        },
        onchange: (/** @type {any} */ event) => Number(event.target.value) !== range.value &&
          placing.settle(one, placement(Number(event.target.value))) }), value);
  };
  const split = (/** @type {string} */ id, /** @type {string} */ text, /** @type {() => void} */ onclick) =>
    el("button", { id: `split-${id}`, onclick, disabled: state.busy }, text);
  return el("details", { class: "online", open: opened, ontoggle: (/** @type {any} */ event) => { opened = event.target.open; } },
    el("summary", {}, "Turn, scale, split"),
    slider("turn", "Turn", { min: -180, max: 180, step: 1, value: 0 }, (turn_degrees) => ({ turn_degrees }), (v) => `${v}°`),
    slider("scale", "Scale", { min: -1, max: 1, step: 0.01, value: 0 }, (v) => ({ scale: Number((3 ** v).toFixed(3)) }),
      (v) => `× ${(3 ** v).toFixed(2)}`),
    el("div", { class: "actions" },
      split("touching", "Split at gaps", () => edits.split(one.id, "touching")),
      split("clusters", "Split in two", () => edits.split(one.id, { by: { clusters: { count: 2 } } })),
      split("lasso", "Split by lasso", () => { state.tool = "lasso"; tell("view"); })));
}
let opened = false;

/** The list of edits, the latest first. */
export function fillEdits() {
  const { scene } = state;
  if (!scene) return;
  const count = scene.edits.length;
  const rows = scene.edits.map(({ words }, k) => el("li", {},
    el("span", {}, named(words, scene.edits[k])),
    el("button", { title: "Undo this and all after it", "aria-label": `Undo back to before edit ${k + 1}`, disabled: state.busy,
      onclick: () => edits.change({ action: "undo_to", edits: k }) }, icon("undo")))).reverse();
  find("#edits").replaceChildren(
    el("div", { class: "actions" },
      el("button", { onclick: edits.undo, disabled: state.busy || count === 0 }, "Undo"),
      el("button", { onclick: edits.redo, disabled: state.busy || scene.undone === 0 }, scene.undone ? `Redo (${scene.undone})` : "Redo")),
    count ? el("ol", { class: "list history", reversed: true }, ...rows) : el("p", { class: "quiet-note" },
      scene.not_editable ?? "Nothing has been edited. Every edit is saved at once, and can be undone later, here or by `tid3r edit`."));
}

/** An edit in words, with the names of those that it is about, where they still are.
 * @param {string} words @param {any} edit */
function named(words, edit) {
  const ids = edit.instances ?? [edit.instance];
  const names = ids.map(instance).filter(Boolean).map((/** @type {any} */ one) => one.name);
  const text = words.charAt(0).toUpperCase() + words.slice(1);
  return names.length === 1 && !names[0].startsWith("instance ") && edit.edit !== "rename" ? `${text} (${names[0]})` : text;
}

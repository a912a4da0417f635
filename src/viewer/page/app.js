// The page: puts its parts together.

import { getScene, offline } from "./api.js";
import { View } from "./camera.js";
import { Controls } from "./controls.js";
import { complain, el, find, icon, readable } from "./dom.js";
import { redo, undo } from "./edits.js";
import { listenToKeys, toggle, useTool } from "./help.js";
import { Lasso } from "./lasso.js";
import { fillEdits, fillObjects } from "./panel.js";
import { fillStrip } from "./photos.js";
import { Placing } from "./placing.js";
import { Renderer } from "./renderer.js";
import { start } from "./renders.js";
import { listen, selection, setScene, state, tell } from "./store.js";

addEventListener("unhandledrejection", (event) => complain(event.reason));

/** Fills the stage with words. @param {string} title @param {string} text @param {boolean} [again] */
function explain(title, text, again = false) {
  const empty = find("#empty");
  empty.hidden = false;
  empty.replaceChildren(el("h2", {}, title), el("p", {}, text),
    ...(again ? [el("button", { class: "primary", onclick: () => location.reload() }, "Try again")] : []));
}

function dressButtons() {
  for (const [id, name] of Object.entries({ move: "move", lasso: "lasso", cameras: "camera", photos: "strip", undo: "undo", redo: "redo", help: "help" })) {
    find(`#${id}`).append(icon(name));
  }
}

/** @param {View} view @param {Renderer} renderer */
function listenToBar(view, renderer) {
  for (const button of find("#modes").children) button.addEventListener("click", () => view.setMode(button.dataset.mode));
  find("#colours").addEventListener("change", (/** @type {any} */ event) => { state.colours = event.target.value; tell("view"); });
  find("#move").addEventListener("click", () => useTool("move"));
  find("#lasso").addEventListener("click", () => useTool("lasso"));
  find("#cameras").addEventListener("click", () => toggle("cameras"));
  find("#photos").addEventListener("click", () => toggle("strip"));
  find("#undo").addEventListener("click", undo);
  find("#redo").addEventListener("click", redo);
  const tabs = [...find("#tabs").children];
  const open = (/** @type {HTMLElement} */ tab) => {
    for (const other of tabs) {
      const own = other === tab;
      other.setAttribute("aria-selected", String(own));
      other.tabIndex = own ? 0 : -1;
      find(`#${other.getAttribute("aria-controls")}`).hidden = !own;
    }
  };
  tabs.forEach((tab, k) => {
    tab.addEventListener("click", () => open(tab));
    tab.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (!step) return;
      const next = tabs[(k + step + tabs.length) % tabs.length];
      open(next);
      next.focus();
    });
  });
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const paint = () => {
    const style = getComputedStyle(document.body);
    const read = (/** @type {string} */ name) => style.getPropertyValue(name).trim().split(" ").map((k) => Number(k) / 255);
    [renderer.paper, renderer.accent] = [read("--stage-rgb"), read("--accent-rgb")];
    renderer.invalidate();
  };
  dark.addEventListener("change", paint);
  paint();
}

/** @param {Renderer} renderer */
function drawBar(renderer) {
  const { scene } = state;
  for (const button of find("#modes").children) button.setAttribute("aria-checked", String(button.dataset.mode === state.mode));
  find("#colours").value = state.colours;
  const pressed = { move: state.tool === "move", lasso: state.tool === "lasso", cameras: state.cameras, photos: state.strip };
  for (const [id, on] of Object.entries(pressed)) find(`#${id}`).setAttribute("aria-pressed", String(on));
  find("#strip").hidden = !state.strip;
  find("#undo").disabled = state.busy || !scene || scene.edits.length === 0;
  find("#redo").disabled = state.busy || !scene || scene.undone === 0;
  document.body.dataset.tool = state.tool;
  document.body.toggleAttribute("data-busy", state.busy);
  const [one] = selection();
  const hint = state.busy ? "Editing…"
    : state.tool === "lasso" ? (one ? `Draw around a part of ${one.name}` : "Select an object first")
      : state.tool === "move" ? "Drag an object along the floor"
        : state.mode === "top" && one && !scene?.not_editable ? `Drag ${one.name} to move it` : "";
  find("#hint").hidden = hint === "";
  find("#hint").textContent = hint;
  renderer.invalidate();
}

function drawLoading() {
  const total = state.scene?.points.count ?? 0;
  const share = total ? state.loaded / total : 1;
  find("#loading").hidden = share >= 1;
  find("#loading").setAttribute("aria-valuenow", String(Math.round(100 * share)));
  find("#loading i").style.width = `${100 * share}%`;
}

async function run() {
  dressButtons();
  const canvas = find("#room");
  const view = new View();
  let renderer;
  try {
    renderer = new Renderer(canvas, view);
  } catch (error) {
    console.warn(error);
    explain("This browser draws no WebGL 2", "Use a recent Firefox, Chrome, Edge or Safari, with hardware acceleration on.");
    return;
  }
  const placing = new Placing(renderer, view);
  const lasso = new Lasso(view);
  const controls = new Controls(canvas, view, renderer, placing, lasso);
  listenToBar(view, renderer);
  listenToKeys(view, controls);

  listen("scene", () => {
    const { scene } = state;
    if (!scene) return;
    document.title = `${scene.name} · tid3r`;
    find("#name").textContent = scene.name;
    find("#name").title = scene.folder ?? "";
    find("#count").textContent = `${readable(scene.points.count)} points`;
    view.adopt(scene);
    fillStrip(view, renderer);
    if (scene.points.count === 0) explain("There is no point left", "Undo brings back what was removed.");
    else find("#empty").hidden = true;
    renderer.cloud.load(scene).then(() => placing.cancel()).catch(complain);
  });
  listen("scene selection busy", () => {
    fillObjects(placing, view);
    fillEdits();
  });
  listen("scene selection", () => renderer.updateTable());
  listen("scene selection view busy", () => drawBar(renderer));
  listen("loaded", () => { drawLoading(); renderer.invalidate(); });
  let last = performance.now();
  const walk = (/** @type {number} */ now) => {
    controls.walk(Math.min(0.1, (now - last) / 1000));
    last = now;
    requestAnimationFrame(walk);
  };
  requestAnimationFrame(walk);
  // The command line may have edited meanwhile.
  addEventListener("focus", async () => {
    if (state.busy || !state.scene || offline) return;
    const scene = await getScene().catch(() => null);
    if (scene && scene.version !== state.scene.version && !state.busy) setScene(scene);
  });

  try {
    const scene = await getScene();
    view.home(scene);
    view.flight = null;
    setScene(scene);
    if (!offline) await start(view);
  } catch (error) {
    const { problem, remedy } = /** @type {any} */ (error);
    if (!problem) throw error;
    explain(problem, remedy, true);
  }
  // For tests, and for the curious.
  Object.assign(window, { tid3r: { state, view, renderer } });
}

run().catch(complain);

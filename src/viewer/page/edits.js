// Changes of the scene: the page asks, the server makes them, and says what the scene is then.

import { offline, send } from "./api.js";
import { complain } from "./dom.js";
import { selection, setScene, state, tell } from "./store.js";

/** Makes a change; whether it was made. One at a time.
 * @param {Record<string, unknown>} action */
export async function change(action) {
  if (state.busy || offline) return false;
  state.busy = true;
  tell("busy");
  try {
    const before = new Set(state.scene?.instances.map((one) => one.id));
    const scene = await send("/api/edits", action);
    // What is new is what one goes on with.
    const added = scene.instances.filter((/** @type {any} */ one) => !before.has(one.id));
    if (added.length > 0 && ["duplicate", "split"].includes(String(action.action))) {
      state.selected = new Set(added.map((/** @type {any} */ one) => one.id));
    }
    setScene(scene);
    return true;
  } catch (error) {
    complain(error);
    return false;
  } finally {
    state.busy = false;
    tell("busy");
  }
}

const ids = () => selection().map((one) => one.id);

export const undo = () => change({ action: "undo" });
export const redo = () => change({ action: "redo" });
export const remove = () => ids().length > 0 && change({ action: "remove", instances: ids() });
export const keepOnly = () => ids().length > 0 && change({ action: "keep_only", instances: ids() });

export function merge() {
  const [instance, ...others] = ids();
  return others.length > 0 && change({ action: "merge", instance, others });
}

/** Puts a copy beside each instance that is selected: beside the first, as the server takes one at a time. */
export function duplicate() {
  const [one] = selection();
  if (!one) return false;
  const aside = Number((1.15 * one.size[0]).toFixed(3));
  return change({ action: "duplicate", instance: one.id, placement: { by: [aside, 0, 0] } });
}

/** @param {string} colour as #rrggbb */
export const recolour = (colour) =>
  ids().length > 0 && change({ action: "recolour", instances: ids(), change: { to: { colour } } });

/** @param {number} instance @param {string} name */
export const rename = (instance, name) => change({ action: "rename", instance, name });

/** @param {number} instance @param {unknown} by */
export const split = (instance, by) => change({ action: "split", instance, by });

/** @param {number} instance @param {Record<string, unknown>} placement */
export const place = (instance, placement) => change({ action: "move", instance, placement });

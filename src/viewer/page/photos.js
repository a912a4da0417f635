// The photo strip, and photos large, in which objects can be picked.

import { getBytes, photoAddress } from "./api.js";
import { complain, el, find, icon } from "./dom.js";
import { instance, select, state } from "./store.js";

/** @param {number} index */
export const address = (index) => photoAddress(state.scene?.version, index);

/** Fills the strip. Its pictures go into the cameras of the 3D view, too.
 * @param {import("./camera.js").View} view @param {import("./renderer.js").Renderer} renderer */
export function fillStrip(view, renderer) {
  const strip = find("#strip");
  // Most edits leave the photos as they are.
  const paints = state.scene?.edits.filter(({ edit }) => edit === "recolour" || edit === "restyle");
  const content = JSON.stringify([state.scene?.photos, paints]);
  if (strip.dataset.content === content) return;
  strip.dataset.content = content;
  strip.replaceChildren(...(state.scene?.photos ?? []).map(({ name, camera }, index) => {
    const image = el("img", { src: address(index), alt: "", draggable: "false",
      onload: () => renderer.setPhoto(index, image) });
    return el("figure", {},
      el("button", { class: "thumb", title: `Stand where ${name} was taken`, "aria-label": `Stand at photo ${name}`,
        onclick: () => view.standAt(state.scene?.photos[index].camera ?? camera) }, image, el("span", {}, name)),
      el("button", { class: "tool enlarge online", title: "Pick in the photo", "aria-label": `Pick in photo ${name}`,
        onclick: () => enlarge(index).catch(complain) }, icon("eye")));
  }));
}

/** Shows a photo large; a click in it selects what is there. @param {number} index */
async function enlarge(index) {
  if (!state.scene) return;
  const { photos, version } = state.scene;
  const { name, camera } = photos[index];
  const { width, height } = camera.intrinsics;
  const labels = new Uint32Array(await getBytes(`/api/labels/${version}/${index}`));
  const dialog = find("#show");
  const close = () => dialog.close();
  const caption = el("p", { class: "caption", "aria-live": "polite" }, "Click an object to select it");
  const overlay = el("canvas", { width, height });
  const at = (/** @type {MouseEvent} */ event) => {
    const box = overlay.getBoundingClientRect();
    const [u, v] = [((event.clientX - box.left) / box.width) * width, ((event.clientY - box.top) / box.height) * height];
    const label = labels[Math.min(height - 1, Math.max(0, Math.floor(v))) * width + Math.min(width - 1, Math.max(0, Math.floor(u)))];
    return instance(label);
  };
  let shown = 0;
  const paint = (/** @type {number} */ id) => {
    if (id === shown) return;
    shown = id;
    const context = overlay.getContext("2d");
    const pixels = context.createImageData(width, height);
    if (id) labels.forEach((label, k) => label === id && pixels.data.set([240, 162, 59, 130], 4 * k));
    context.putImageData(pixels, 0, 0);
  };
  overlay.addEventListener("pointermove", (/** @type {MouseEvent} */ event) => {
    const found = at(event);
    caption.textContent = found ? found.name : "Nothing that has a name";
    paint(found?.id ?? 0);
  });
  overlay.addEventListener("click", (/** @type {MouseEvent} */ event) => {
    const found = at(event);
    if (!found) return;
    select(found.id, event.shiftKey);
    close();
  });
  dialog.replaceChildren(
    el("header", {}, el("h2", {}, name), el("button", { class: "tool", "aria-label": "Close", onclick: close }, icon("close"))),
    el("div", { class: "picture" }, el("img", { src: address(index), alt: `Photo ${name}` }), overlay), caption);
  dialog.showModal();
  paint([...state.selected][0] ?? 0);
}

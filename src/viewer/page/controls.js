// Pointers on the canvas: mouse, pen, fingers.

import { state, instance, select, selection, tell } from "./store.js";

/** A press that goes no farther is a click, pixels. */
const STILL = 5;

export class Controls {
  /** @param {HTMLCanvasElement} canvas @param {import("./camera.js").View} view
   * @param {import("./renderer.js").Renderer} renderer @param {import("./placing.js").Placing} placing
   * @param {import("./lasso.js").Lasso} lasso */
  constructor(canvas, view, renderer, placing, lasso) {
    this.canvas = canvas;
    this.view = view;
    this.renderer = renderer;
    this.placing = placing;
    this.lasso = lasso;
    /** @type {Map<number, {x: number, y: number}>} */
    this.pointers = new Map();
    this.travelled = 0;
    /** @type {"turn" | "pan" | "place" | "lasso"} */
    this.doing = "turn";
    /** Keys that are held down. @type {Set<string>} */
    this.keys = new Set();
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.moved(event));
    canvas.addEventListener("pointerup", (event) => this.up(event));
    canvas.addEventListener("pointercancel", (event) => this.abandon(event));
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("dblclick", (event) => this.centre(event));
    addEventListener("blur", () => this.keys.clear());
  }

  /** @param {MouseEvent} event @returns {[number, number]} */
  place(event) {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  /** @param {PointerEvent} event */
  down(event) {
    this.canvas.focus({ preventScroll: true });
    this.canvas.setPointerCapture(event.pointerId);
    const [x, y] = this.place(event);
    this.pointers.set(event.pointerId, { x, y });
    if (this.pointers.size > 1) {
      this.travelled = Infinity;
      this.lasso.clear();
      if (this.doing === "place") this.placing.cancel();
      this.doing = "pan";
      return;
    }
    this.travelled = 0;
    const pans = event.button === 1 || event.button === 2 || event.shiftKey;
    if (state.tool === "lasso" && event.button === 0) {
      this.doing = "lasso";
      this.lasso.add(x, y);
    } else if (event.button === 0 && !event.shiftKey && this.takes(x, y)) this.doing = "place";
    else this.doing = pans || state.mode === "top" ? "pan" : "turn";
  }

  /** Whether a press begins to move an instance: with the tool, and on the map what is selected.
   * @param {number} x @param {number} y */
  takes(x, y) {
    if (state.busy || (state.tool !== "move" && state.mode !== "top") || state.scene?.not_editable) return false;
    const found = this.renderer.pick(x, y);
    const one = found && instance(found.id);
    if (!one || (state.tool !== "move" && !state.selected.has(one.id))) return false;
    if (!state.selected.has(one.id) || state.selected.size > 1) select(one.id);
    return this.placing.take(one, x, y);
  }

  /** @param {PointerEvent} event */
  moved(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const [x, y] = this.place(event);
    const [dx, dy] = [x - before.x, y - before.y];
    this.travelled += Math.hypot(dx, dy);
    if (this.pointers.size === 2) this.pinch(event.pointerId, { x, y });
    else if (this.doing === "lasso") this.lasso.add(x, y);
    else if (this.doing === "place") this.placing.pull(x, y);
    else if (this.travelled > STILL || event.pointerType === "mouse") {
      if (this.doing === "turn") this.view.turn(dx, dy);
      else this.view.pan(dx, dy);
    }
    this.pointers.set(event.pointerId, { x, y });
    if (this.doing !== "lasso") this.renderer.move();
  }

  /** Two fingers: their distance zooms, their middle pans. @param {number} id @param {{x: number, y: number}} to */
  pinch(id, to) {
    const from = this.pointers.get(id);
    const other = [...this.pointers].find(([key]) => key !== id)?.[1];
    if (!from || !other) return;
    const apart = (/** @type {{x: number, y: number}} */ one) => Math.hypot(one.x - other.x, one.y - other.y) || 1;
    this.view.pan((to.x - from.x) / 2, (to.y - from.y) / 2);
    this.view.zoom(apart(from) / apart(to), (to.x + other.x) / 2, (to.y + other.y) / 2);
  }

  /** @param {PointerEvent} event */
  up(event) {
    if (!this.pointers.delete(event.pointerId)) return;
    const [x, y] = this.place(event);
    if (this.doing === "lasso") {
      const whole = this.travelled > STILL;
      state.tool = "look";
      tell("view");
      if (whole) this.lasso.close(selection()[0]);
      else this.lasso.clear();
    } else if (this.travelled <= STILL && event.button === 0) {
      this.placing.cancel();
      const found = this.renderer.pick(x, y);
      const known = found && instance(found.id) ? found.id : null;
      select(known, event.shiftKey || event.ctrlKey || event.metaKey);
    } else if (this.doing === "place") this.placing.release();
    this.renderer.move();
  }

  /** @param {PointerEvent} event */
  abandon(event) {
    this.pointers.delete(event.pointerId);
    this.lasso.clear();
    this.placing.cancel();
  }

  /** @param {WheelEvent} event */
  wheel(event) {
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 16 : 1;
    this.view.zoom(Math.exp(event.deltaY * lines * 0.0015), ...this.place(event));
    this.renderer.move();
  }

  /** Turns around what was clicked from now on. @param {MouseEvent} event */
  centre(event) {
    const found = this.renderer.pick(...this.place(event));
    if (!found || state.mode !== "orbit") return;
    this.view.fly(() => {
      this.view.release();
      this.view.target = found.at;
      this.view.distance *= 0.6;
    });
  }

  /** Walks by the keys that are held down. @param {number} seconds */
  walk(seconds) {
    if (state.mode !== "fly" || this.keys.size === 0) return;
    const along = (/** @type {string} */ plus, /** @type {string} */ minus) =>
      Number(this.keys.has(plus)) - Number(this.keys.has(minus));
    const way = /** @type {[number, number, number]} */ ([along("d", "a"), along("e", "q"), along("w", "s")]);
    if (way.every((k) => k === 0)) return;
    const step = this.view.size * 0.25 * seconds;
    this.view.walk(/** @type {[number, number, number]} */ (way.map((k) => k * step)));
    this.renderer.move();
  }
}

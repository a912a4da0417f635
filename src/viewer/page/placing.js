// Moving, turning and scaling what is selected: shown at once, and made an edit when it is let go.

import { change } from "./edits.js";
import * as m from "./math.js";

export class Placing {
  /** @param {import("./renderer.js").Renderer} renderer @param {import("./camera.js").View} view */
  constructor(renderer, view) {
    this.renderer = renderer;
    this.view = view;
    /** @type {{instance: import("./store.js").Instance, grip: m.Vec3, by: [number, number]} | null} */
    this.drag = null;
  }

  /** Shows an instance where a placement would put it.
   * @param {import("./store.js").Instance} instance @param {{by?: number[], turn_degrees?: number, scale?: number}} to */
  preview(instance, { by = [0, 0, 0], turn_degrees: degrees = 0, scale = 1 }) {
    const [x, y, z] = instance.floor_box;
    /** @type {m.Vec3} */
    const base = [(x[0] + x[1]) / 2, (y[0] + y[1]) / 2, z[0]];
    const [sine, cosine] = [Math.sin((degrees * Math.PI) / 180), Math.cos((degrees * Math.PI) / 180)];
    const turned = m.fromColumns([scale * cosine, scale * sine, 0], [-scale * sine, scale * cosine, 0], [0, 0, scale], [0, 0, 0]);
    const shift = m.sub(m.add(base, /** @type {m.Vec3} */ (by)), m.turn(turned, base));
    for (let k = 0; k < 3; k++) turned[12 + k] = shift[k];
    const { floor } = this.view;
    const motion = m.multiply(floor, m.multiply(turned, m.invertRigid(floor)));
    this.renderer.carried = { id: instance.id, motion, scale };
    this.renderer.invalidate();
  }

  /** Makes what is shown an edit. The preview stays until the new points are there.
   * @param {import("./store.js").Instance} instance @param {Record<string, unknown>} placement */
  async settle(instance, placement) {
    const made = await change({ action: "move", instance: instance.id, placement });
    if (!made) this.cancel();
  }

  /** Shows everything where it is. */
  cancel() {
    this.drag = null;
    this.renderer.carried = null;
    this.renderer.invalidate();
  }

  /** Takes hold of an instance at a place of the canvas; whether there is a floor under it.
   * @param {import("./store.js").Instance} instance @param {number} x @param {number} y */
  take(instance, x, y) {
    const grip = this.view.onLevel(x, y, instance.floor_box[2][0]);
    if (grip) this.drag = { instance, grip, by: [0, 0] };
    return grip !== null;
  }

  /** @param {number} x @param {number} y */
  pull(x, y) {
    if (!this.drag) return;
    const { instance, grip } = this.drag;
    const at = this.view.onLevel(x, y, instance.floor_box[2][0]);
    if (!at) return;
    this.drag.by = [at[0] - grip[0], at[1] - grip[1]];
    this.preview(instance, { by: [...this.drag.by, 0] });
  }

  release() {
    if (!this.drag) return;
    const { instance, by } = this.drag;
    this.drag = null;
    if (Math.hypot(...by) < 1e-4 * this.view.size) return this.cancel();
    const round = (/** @type {number} */ k) => Number(k.toFixed(4));
    this.settle(instance, { by: [round(by[0]), round(by[1]), 0] });
  }
}

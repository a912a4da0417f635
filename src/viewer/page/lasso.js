// An outline drawn over the room: what of an instance is seen within becomes one of its own.

import { find, say } from "./dom.js";
import { split } from "./edits.js";

/** Corners nearer to each other than this are one, pixels. */
const APART = 4;

export class Lasso {
  /** @param {import("./camera.js").View} view */
  constructor(view) {
    this.view = view;
    /** @type {[number, number][]} */
    this.corners = [];
    this.shape = find("#outline polygon");
  }

  /** @param {number} x @param {number} y */
  add(x, y) {
    const last = this.corners.at(-1);
    if (last && Math.hypot(last[0] - x, last[1] - y) < APART) return;
    if (this.corners.length < 900) this.corners.push([x, y]);
    this.draw();
  }

  clear() {
    this.corners = [];
    this.draw();
  }

  draw() {
    this.shape.setAttribute("points", this.corners.map((corner) => corner.join(",")).join(" "));
  }

  /** Splits an instance by what was drawn. @param {import("./store.js").Instance | undefined} instance */
  async close(instance) {
    const { corners } = this;
    if (!instance) say("Select one object first", "then draw around a part of it");
    else if (corners.length >= 3) {
      await split(instance.id, { by: { outline: { camera: this.view.camera(), corners } } });
    }
    this.clear();
  }
}

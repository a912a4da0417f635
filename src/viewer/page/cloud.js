// The points on the graphics card, as they arrive.

import { getChunk } from "./api.js";
import { state, tell } from "./store.js";

/** How many chunks are asked for ahead of the one that is waited for. */
const AHEAD = 3;

export class Cloud {
  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.gl = gl;
    /** Points that can be drawn. */
    this.count = 0;
    this.total = 0;
    this.version = "";
    /** @type {WebGLVertexArrayObject | null} */
    this.array = null;
    /** @type {WebGLBuffer | null} */
    this.buffer = null;
    this.loading = new AbortController();
  }

  /** Fetches the points of a scene. The first ones appear as they arrive; later clouds replace the one that is
   * shown once they are whole. @param {import("./store.js").Scene} scene */
  async load(scene) {
    if (scene.version === this.version) return;
    this.loading.abort();
    this.loading = new AbortController();
    const { signal } = this.loading;
    this.version = scene.version;
    const { gl } = this;
    const { count, chunk, record } = scene.points;
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, Math.max(1, count * record), gl.STATIC_DRAW);
    const progressive = this.count === 0;
    if (progressive) this.show(buffer, record, 0, count);
    const chunks = Math.ceil(count / chunk);
    /** @type {Promise<ArrayBuffer>[]} */
    const asked = [];
    const ask = (/** @type {number} */ k) => {
      asked[k] = getChunk(scene.version, k, signal);
      asked[k].catch(() => {});
    };
    try {
      for (let k = 0; k < chunks; k++) {
        for (let next = asked.length; next <= Math.min(k + AHEAD, chunks - 1); next++) ask(next);
        const bytes = await asked[k];
        if (signal.aborted) throw new DOMException("", "AbortError");
        gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
        gl.bufferSubData(gl.ARRAY_BUFFER, k * chunk * record, new Uint8Array(bytes));
        const there = Math.min(count, (k + 1) * chunk);
        if (progressive) {
          this.count = there;
          state.loaded = there;
          tell("loaded");
        }
      }
    } catch (error) {
      if (this.buffer !== buffer) gl.deleteBuffer(buffer);
      if (!signal.aborted) this.version = "";
      if (/** @type {any} */ (error).name === "AbortError") return;
      throw error;
    }
    if (!progressive) this.show(buffer, record, count, count);
    state.loaded = count;
    tell("loaded");
  }

  /** @param {WebGLBuffer | null} buffer @param {number} record @param {number} count @param {number} total */
  show(buffer, record, count, total) {
    const { gl } = this;
    if (this.buffer) gl.deleteBuffer(this.buffer);
    if (this.array) gl.deleteVertexArray(this.array);
    [this.buffer, this.count, this.total] = [buffer, count, total];
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    for (let k = 0; k < 6; k++) gl.enableVertexAttribArray(k);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, record, 0);
    gl.vertexAttribPointer(1, 4, gl.UNSIGNED_BYTE, true, record, 12);
    gl.vertexAttribIPointer(2, 1, gl.UNSIGNED_INT, record, 16);
    gl.vertexAttribPointer(3, 1, gl.HALF_FLOAT, false, record, 20);
    gl.vertexAttribIPointer(4, 1, gl.UNSIGNED_SHORT, record, 22);
    gl.vertexAttribPointer(5, 3, gl.BYTE, true, record, 24);
    gl.bindVertexArray(null);
  }
}

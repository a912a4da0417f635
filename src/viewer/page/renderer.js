// Draws the room: points, cameras, boxes; and knows which instance is where.

import { Cloud } from "./cloud.js";
import { allocate, lineArray, program, target } from "./gl.js";
import * as m from "./math.js";
import * as shaders from "./shaders.js";
import { isShown, selection, state } from "./store.js";

/** A picture that takes longer than this is drawn with fewer points while the camera moves, milliseconds. */
const SLOW = 24;
const QUICK = 18;
const FEWEST = 60_000;
/** How many times as long the picture may take that is drawn once the camera rests, and what is drawn to see what is where. */
const PATIENCE = 10;
/** Points that are drawn then in any case. */
const MANY = 400_000;
/** The camera rests once nothing has moved for so long, milliseconds. */
const REST = 140;

export class Renderer {
  /** @param {HTMLCanvasElement} canvas @param {import("./camera.js").View} view */
  constructor(canvas, view) {
    const options = { antialias: false, alpha: false, powerPreference: "high-performance" };
    const gl = /** @type {WebGL2RenderingContext | null} */ (canvas.getContext("webgl2", options));
    if (!gl) throw new Error("no WebGL 2");
    this.canvas = canvas;
    this.view = view;
    this.gl = gl;
    this.cloud = new Cloud(gl);
    this.points = program(gl, shaders.POINTS, shaders.POINT_COLOUR);
    this.ids = program(gl, shaders.POINTS, shaders.POINT_ID);
    this.lines = program(gl, shaders.LINES, shaders.LINE_COLOUR);
    this.pictures = program(gl, shaders.PICTURE, shaders.PICTURE_COLOUR);
    this.screen = program(gl, shaders.SCREEN, shaders.LIGHTING);
    this.empty = gl.createVertexArray();
    this.lineArray = lineArray(gl);
    this.table = gl.createTexture();
    this.target = target(gl);
    this.idTarget = target(gl);
    /** How an instance is shown that is on its way. @type {{id: number, motion: m.Mat4, scale: number} | null} */
    this.carried = null;
    /** @type {Map<number, {texture: WebGLTexture, array: WebGLVertexArrayObject}>} */
    this.photos = new Map();
    /** Points to draw while the camera moves. */
    this.budget = 1_500_000;
    this.moved = 0;
    this.last = 0;
    this.wanted = true;
    this.paper = [0.09, 0.1, 0.11];
    this.accent = [1, 0.6, 0.1];
    this.stats = { drawn: 0, milliseconds: 0 };
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => location.reload());
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.resize();
    requestAnimationFrame((now) => this.frame(now));
  }

  /** Draws soon. */
  invalidate() {
    this.wanted = true;
  }

  /** Draws soon, and with fewer points if all take too long. */
  move() {
    this.moved = performance.now();
    this.wanted = true;
  }

  resize() {
    const { canvas, gl } = this;
    const density = Math.min(devicePixelRatio || 1, 2);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(1, Math.round(side * density)));
    [this.view.width, this.view.height] = [Math.max(1, canvas.clientWidth), Math.max(1, canvas.clientHeight)];
    if (canvas.width !== width || canvas.height !== height || !this.target.width) {
      [canvas.width, canvas.height] = [width, height];
      allocate(gl, this.target, width, height, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE);
      allocate(gl, this.idTarget, width, height, gl.RGBA32UI, gl.RGBA_INTEGER, gl.UNSIGNED_INT);
    }
    this.invalidate();
  }

  /** @param {number} now */
  frame(now) {
    requestAnimationFrame((next) => this.frame(next));
    const flying = this.view.flight !== null;
    if (flying) this.move();
    const moving = now - this.moved < REST;
    if (!this.wanted && !moving) {
      this.last = 0;
      return;
    }
    if (moving && this.last) {
      const took = now - this.last;
      this.stats.milliseconds = took;
      if (took > SLOW) this.budget = Math.max(FEWEST, Math.min(this.budget, this.cloud.count) * Math.max(0.5, SLOW / took));
      else if (took < QUICK) this.budget = Math.min(8_000_000, this.budget * 1.1);
    }
    this.last = moving ? now : 0;
    // One more picture once the camera rests, with all points that can be had in a moment.
    this.wanted = moving;
    this.draw(moving ? Math.min(this.budget, this.cloud.count) : this.most(), now);
  }

  /** The points that can be drawn in a moment: all of them, unless there is no graphics card. */
  most() {
    return Math.min(this.cloud.count, Math.max(MANY, PATIENCE * this.budget));
  }

  /** @param {number} count @param {number} now */
  draw(count, now) {
    const { gl, view, canvas } = this;
    const lens = view.lens();
    const [near, far] = view.range();
    const projection = m.projection(lens, near, far);
    const world = m.invertRigid(view.pose(now));
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target.frame);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 1);
    gl.enable(gl.DEPTH_TEST);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.stats.drawn = Math.floor(count);
    this.drawPoints(this.points, world, projection, lens, this.stats.drawn);
    if (state.cameras) this.drawCameras(world, projection);
    this.drawBoxes(world, projection);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.disable(gl.DEPTH_TEST);
    gl.useProgram(this.screen.program);
    gl.bindVertexArray(this.empty);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.target.colour);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.target.depth);
    const { uniforms } = this.screen;
    gl.uniform1i(uniforms.picture, 0);
    gl.uniform1i(uniforms.depths, 1);
    gl.uniform2f(uniforms.range, near, far);
    const top = state.mode === "top";
    gl.uniform1f(uniforms.strength, top ? 20 : 1.3);
    gl.uniform1f(uniforms.tolerance, top ? 0.002 : 0.03);
    gl.uniform1f(uniforms.reach, Math.max(1, Math.round(canvas.width / canvas.clientWidth)));
    gl.uniform3fv(uniforms.paper, this.paper);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.activeTexture(gl.TEXTURE0);
  }

  /** @param {import("./gl.js").Program} program @param {m.Mat4} world @param {m.Mat4} projection @param {m.Lens} lens
   * @param {number} count */
  drawPoints({ program, uniforms }, world, projection, lens, count) {
    const { gl, cloud } = this;
    if (!cloud.array || count === 0) return;
    gl.useProgram(program);
    gl.bindVertexArray(cloud.array);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.table);
    gl.uniform1i(uniforms.table, 0);
    gl.uniformMatrix4fv(uniforms.view, false, world);
    gl.uniformMatrix4fv(uniforms.projection, false, projection);
    gl.uniformMatrix4fv(uniforms.motion, false, this.carried?.motion ?? m.identity());
    gl.uniform1ui(uniforms.moved, this.carried?.id ?? 0);
    gl.uniform1f(uniforms.motionScale, this.carried?.scale ?? 1);
    gl.uniform1f(uniforms.pixels, (lens.fy * this.canvas.height) / lens.height);
    // Fewer points stand for more of the surface around them.
    gl.uniform1f(uniforms.grown, 1.15 * Math.min(3, Math.sqrt(cloud.total / count)));
    // From behind, surfaces are left out: one looks into the room from outside.
    gl.uniform1f(uniforms.behind, state.behind ? -2 : -0.05);
    gl.uniform3fv(uniforms.eye, m.position(this.view.pose()));
    const up = m.axis(this.view.floor, 2);
    gl.uniform4f(uniforms.height, ...up, -m.dot(up, m.position(this.view.floor)));
    gl.uniform1f(uniforms.cut, state.mode === "top" ? this.view.ceiling : 1e30);
    gl.uniform1i(uniforms.mode, ["photo", "instance", "confidence", "origin"].indexOf(state.colours));
    gl.uniform3fv(uniforms.accent, this.accent);
    gl.drawArrays(gl.POINTS, 0, count);
  }

  /** The instance at a place of the canvas and where it is, in the floor's frame; `null` where nothing is.
   * @param {number} x @param {number} y @returns {{id: number, at: m.Vec3} | null} */
  pick(x, y) {
    const density = this.canvas.width / this.view.width;
    const reach = Math.round(4 * density);
    const side = 2 * reach + 1;
    const answers = this.seen(Math.round(x * density) - reach, Math.round(y * density) - reach, side, side);
    let best = null;
    let nearest = Infinity;
    for (let k = 0; k < side * side; k++) {
      const off = Math.hypot((k % side) - reach, Math.floor(k / side) - reach);
      if (answers[4 * k + 2] && off < nearest) [best, nearest] = [k, off];
    }
    if (best === null) return null;
    const depth = new Float32Array(answers.buffer)[4 * best + 1];
    const { from, along } = this.view.ray(x, y);
    return { id: answers[4 * best], at: m.add(from, m.scale(along, depth)) };
  }

  /** What is seen in a part of the canvas, four numbers for each pixel, the lowest row first: instance, depth (the bits
   * of a float), and 1 where there is a point.
   * @param {number} left @param {number} top @param {number} width @param {number} height of the canvas's pixels */
  seen(left, top, width, height) {
    const { gl, canvas, view } = this;
    const bottom = canvas.height - top - height;
    const lens = view.lens();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.idTarget.frame);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(left, bottom, width, height);
    gl.clearBufferuiv(gl.COLOR, 0, [0, 0, 0, 0]);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    const [near, far] = view.range();
    const world = m.invertRigid(view.pose());
    this.drawPoints(this.ids, world, m.projection(lens, near, far), lens, this.most());
    gl.disable(gl.SCISSOR_TEST);
    const answers = new Uint32Array(4 * width * height);
    gl.readPixels(left, bottom, width, height, gl.RGBA_INTEGER, gl.UNSIGNED_INT, answers);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return answers;
  }

  /** Writes down how each instance is shown. */
  updateTable() {
    const { gl } = this;
    const instances = state.scene?.instances ?? [];
    const most = instances.reduce((id, one) => Math.max(id, one.id), 0);
    const rows = Math.min(Math.floor(most / shaders.TABLE_WIDTH) + 1, gl.getParameter(gl.MAX_TEXTURE_SIZE));
    const content = new Uint8Array(shaders.TABLE_WIDTH * rows * 4);
    if (state.isolated) content[3] = shaders.HIDDEN;
    for (const { id, colour } of instances) {
      if (id >= shaders.TABLE_WIDTH * rows) continue;
      content.set(colour, 4 * id);
      content[4 * id + 3] = (isShown(id) ? 0 : shaders.HIDDEN) | (state.selected.has(id) ? shaders.SELECTED : 0);
    }
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.table);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8UI, shaders.TABLE_WIDTH, rows, 0, gl.RGBA_INTEGER, gl.UNSIGNED_BYTE, content);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    this.invalidate();
  }

  /** How large cameras are drawn. */
  cameraSize() {
    return 0.035 * this.view.size;
  }

  /** Shows a photo in its camera. @param {number} index @param {HTMLImageElement} image */
  setPhoto(index, image) {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, image);
    gl.generateMipmap(gl.TEXTURE_2D);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    const old = this.photos.get(index);
    if (old) {
      gl.deleteTexture(old.texture);
      gl.deleteVertexArray(old.array);
    }
    const camera = state.scene?.photos[index]?.camera;
    if (!camera) return;
    const [a, b, c, d] = corners(camera, this.cameraSize());
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    const content = [...a, 0, 0, ...b, 1, 0, ...d, 0, 1, ...c, 1, 1];
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(content), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 20, 0);
    gl.vertexAttribPointer(1, 2, gl.FLOAT, false, 20, 12);
    gl.bindVertexArray(null);
    this.photos.set(index, { texture, array });
    this.invalidate();
  }

  /** @param {m.Mat4} world @param {m.Mat4} projection */
  drawCameras(world, projection) {
    const { gl } = this;
    const photos = state.scene?.photos ?? [];
    const stands = this.view.photo;
    gl.useProgram(this.pictures.program);
    gl.uniformMatrix4fv(this.pictures.uniforms.view, false, world);
    gl.uniformMatrix4fv(this.pictures.uniforms.projection, false, projection);
    gl.uniform1i(this.pictures.uniforms.picture, 0);
    for (const [index, { texture, array }] of this.photos) {
      if (photos[index]?.camera === stands) continue;
      gl.bindVertexArray(array);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    }
    /** @type {number[]} */
    const segments = [];
    for (const { camera } of photos) {
      if (camera === stands) continue;
      const eye = m.position(m.fromRows(camera.cam_to_world));
      const around = corners(camera, this.cameraSize());
      around.forEach((corner, k) => segments.push(...eye, ...corner, ...corner, ...around[(k + 1) % 4]));
    }
    this.drawLines(segments, world, projection, [0.75, 0.78, 0.82, 1]);
  }

  /** The boxes of what is selected, where they are carried to. @param {m.Mat4} world @param {m.Mat4} projection */
  drawBoxes(world, projection) {
    /** @type {number[]} */
    const segments = [];
    for (const one of selection()) {
      if (!isShown(one.id)) continue;
      const place = (/** @type {number} */ k) => {
        const at = /** @type {m.Vec3} */ (one.floor_box.map((range, axis) => range[(k >> axis) & 1]));
        const there = m.transform(this.view.floor, at);
        return this.carried?.id === one.id ? m.transform(this.carried.motion, there) : there;
      };
      for (let k = 0; k < 8; k++)
        for (let axis = 0; axis < 3; axis++)
          if (!(k & (1 << axis))) segments.push(...place(k), ...place(k | (1 << axis)));
    }
    this.drawLines(segments, world, projection, [...this.accent, 1]);
  }

  /** @param {number[]} segments @param {m.Mat4} world @param {m.Mat4} projection @param {number[]} paint */
  drawLines(segments, world, projection, paint) {
    if (segments.length === 0) return;
    const { gl } = this;
    gl.useProgram(this.lines.program);
    gl.uniformMatrix4fv(this.lines.uniforms.view, false, world);
    gl.uniformMatrix4fv(this.lines.uniforms.projection, false, projection);
    gl.uniform4fv(this.lines.uniforms.paint, paint);
    gl.bindVertexArray(this.lineArray.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.lineArray.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(segments), gl.DYNAMIC_DRAW);
    gl.drawArrays(gl.LINES, 0, segments.length / 3);
    gl.bindVertexArray(null);
  }
}

/** The corners of a camera's picture, from the top left one clockwise, so far before it.
 * @param {import("./store.js").Camera} camera @param {number} far @returns {m.Vec3[]} */
function corners({ intrinsics: lens, cam_to_world: rows }, far) {
  const pose = m.fromRows(rows);
  const at = (/** @type {number} */ u, /** @type {number} */ v) =>
    m.transform(pose, [((u - lens.cx) / lens.fx) * far, ((v - lens.cy) / lens.fy) * far, far]);
  const [w, h] = [lens.width - 0.5, lens.height - 0.5];
  return [at(-0.5, -0.5), at(w, -0.5), at(w, h), at(-0.5, h)];
}

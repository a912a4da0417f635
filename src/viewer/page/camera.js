// From where the room is seen. Positions and angles are in the floor's frame: z is up.

import * as m from "./math.js";
import { state, tell } from "./store.js";

const HALF_TURN = Math.PI / 2 - 0.001;
/** Of a free camera, from top to bottom. */
const FIELD = (55 * Math.PI) / 180;
/** From above, the camera is so far away that the picture is as good as a map. */
const MAP_FIELD = (6 * Math.PI) / 180;

export class View {
  constructor() {
    this.floor = m.identity();
    /** How large the room is. */
    this.size = 1;
    /** @type {m.Vec3} */
    this.target = [0, 0, 0];
    /** Where the camera looks to: counter-clockwise from y, and upwards. */
    this.yaw = 0;
    this.pitch = -0.3;
    this.distance = 1;
    /** What the map shows from top to bottom. */
    this.extent = 1;
    this.field = FIELD;
    /** The exact camera of a photo that one stands at. @type {import("./store.js").Camera | null} */
    this.photo = null;
    /** @type {{from: m.Mat4, start: number} | null} */
    this.flight = null;
    this.width = 1;
    this.height = 1;
    /** Floor heights above this are left out, from above. */
    this.ceiling = Infinity;
  }

  /** Looks at all of a scene. @param {import("./store.js").Scene} scene */
  home(scene) {
    this.floor = m.fromRows(scene.floor_to_world);
    const [x, y, z] = scene.floor_box;
    this.size = Math.max(x[1] - x[0], y[1] - y[0], z[1] - z[0], 1e-6);
    const toFloor = m.invertRigid(this.floor);
    const eyes = scene.photos.map(({ camera }) =>
      m.transform(toFloor, m.position(m.fromRows(camera.cam_to_world)))[2]);
    this.ceiling = eyes.sort((a, b) => a - b)[Math.floor(eyes.length / 2)] ?? Infinity;
    this.fly(() => {
      this.photo = null;
      this.field = FIELD;
      this.target = [(x[0] + x[1]) / 2, (y[0] + y[1]) / 2, z[0] + 0.35 * (z[1] - z[0])];
      this.extent = 1.15 * Math.max(y[1] - y[0], (x[1] - x[0]) * (this.height / this.width));
      this.distance = 0.75 * this.size * Math.max(1, this.height / this.width);
      [this.yaw, this.pitch] = [-0.35, -0.42];
    });
  }

  /** Takes the room over from a scene that was edited. @param {import("./store.js").Scene} scene */
  adopt(scene) {
    this.floor = m.fromRows(scene.floor_to_world);
    const own = JSON.stringify(this.photo);
    this.photo = scene.photos.find(({ camera }) => JSON.stringify(camera) === own)?.camera ?? this.photo;
  }

  /** The camera's axes and position in the floor's frame. @returns {m.Mat4} */
  onFloor() {
    if (this.photo && state.mode !== "top") {
      return m.multiply(m.invertRigid(this.floor), m.fromRows(this.photo.cam_to_world));
    }
    if (state.mode === "top") {
      const away = this.extent / 2 / Math.tan(MAP_FIELD / 2);
      const { target } = this;
      return m.fromColumns([1, 0, 0], [0, -1, 0], [0, 0, -1], [target[0], target[1], target[2] + away]);
    }
    const forward = this.forward();
    const right = m.normalize(m.cross(forward, [0, 0, 1]));
    return m.fromColumns(right, m.cross(forward, right), forward,
      m.sub(this.target, m.scale(forward, this.distance)));
  }

  /** @returns {m.Vec3} */
  forward() {
    const flat = Math.cos(this.pitch);
    return [-Math.sin(this.yaw) * flat, Math.cos(this.yaw) * flat, Math.sin(this.pitch)];
  }

  /** Camera to world, on the way there if it flies. @param {number} [now] */
  pose(now = performance.now()) {
    const goal = m.multiply(this.floor, this.onFloor());
    if (!this.flight) return goal;
    const share = m.clamp((now - this.flight.start) / 450, 0, 1);
    if (share === 1) {
      this.flight = null;
      return goal;
    }
    return m.between(this.flight.from, goal, share * share * (3 - 2 * share));
  }

  /** The lens, of a picture of the canvas's size. @returns {m.Lens} */
  lens() {
    const { width, height } = this;
    const field = state.mode === "top" ? MAP_FIELD : this.photo ? this.photoField(this.photo) : this.field;
    const f = height / 2 / Math.tan(field / 2);
    return { width, height, fx: f, fy: f, cx: (width - 1) / 2, cy: (height - 1) / 2 };
  }

  /** All of a photo fits in. @param {import("./store.js").Camera} photo */
  photoField({ intrinsics: lens }) {
    const upright = lens.height / lens.fy;
    const wide = (lens.width / lens.fx) * (this.height / this.width);
    return 2 * Math.atan(Math.max(upright, wide) / 2);
  }

  /** Nearest and farthest that is seen. */
  range() {
    if (state.mode === "top") {
      const away = this.extent / 2 / Math.tan(MAP_FIELD / 2);
      return [Math.max(away - 3 * this.size, away * 0.01), away + 3 * this.size];
    }
    return [this.size * 0.004, this.size * 12];
  }

  /** What the page looks from, for the server. @returns {import("./store.js").Camera} */
  camera() {
    const { width, height, ...lens } = this.lens();
    return { intrinsics: { width: Math.round(width), height: Math.round(height), ...lens },
      cam_to_world: m.toRows(this.pose()) };
  }

  /** Goes somewhere smoothly. @param {() => void} change */
  fly(change) {
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const from = this.pose();
    change();
    this.flight = still ? null : { from, start: performance.now() };
    tell("view");
  }

  /** Stands where a photo was taken. @param {import("./store.js").Camera} photo */
  standAt(photo) {
    this.fly(() => {
      if (state.mode === "top") state.mode = "fly";
      this.release(photo);
      this.photo = photo;
    });
  }

  /** Leaves a photo's exact camera, for one that is free. */
  release(photo = this.photo) {
    if (!photo) return;
    this.field = this.photoField(photo);
    const pose = m.multiply(m.invertRigid(this.floor), m.fromRows(photo.cam_to_world));
    const forward = m.axis(pose, 2);
    this.yaw = Math.atan2(-forward[0], forward[1]);
    this.pitch = m.clamp(Math.asin(m.clamp(forward[2], -1, 1)), -HALF_TURN, HALF_TURN);
    this.distance = 0.35 * this.size;
    this.target = m.add(m.position(pose), m.scale(this.forward(), this.distance));
    this.photo = null;
  }

  /** @param {import("./store.js").CameraMode} mode */
  setMode(mode) {
    this.fly(() => {
      this.release();
      state.mode = mode;
    });
  }

  /** Looks at a box of the floor's frame. @param {number[][]} box */
  lookAt([x, y, z]) {
    this.fly(() => {
      this.release();
      const size = Math.max(x[1] - x[0], y[1] - y[0], z[1] - z[0]);
      this.target = [(x[0] + x[1]) / 2, (y[0] + y[1]) / 2, (z[0] + z[1]) / 2];
      this.distance = Math.max(1.6 * size, 0.05 * this.size);
      this.extent = Math.max(4 * size, 0.1 * this.size);
    });
  }

  /** Turns by pixels. @param {number} dx @param {number} dy */
  turn(dx, dy) {
    this.release();
    const eye = m.position(this.onFloor());
    const way = state.mode === "fly" ? 1 : -1;
    const speed = 2.6 / Math.max(400, this.height);
    this.yaw += way * dx * speed;
    this.pitch = m.clamp(this.pitch + way * dy * speed, -HALF_TURN, HALF_TURN);
    if (state.mode === "fly") this.target = m.add(eye, m.scale(this.forward(), this.distance));
  }

  /** Moves sideways by pixels: what is grabbed stays under the finger. @param {number} dx @param {number} dy */
  pan(dx, dy) {
    this.release();
    const pose = this.onFloor();
    const span = state.mode === "top" ? this.extent : 2 * this.distance * Math.tan(this.field / 2);
    const k = span / this.height;
    const shift = m.add(m.scale(m.axis(pose, 0), -dx * k), m.scale(m.axis(pose, 1), -dy * k));
    this.target = m.add(this.target, shift);
  }

  /** Goes nearer, towards a place of the canvas. @param {number} factor @param {number} x @param {number} y */
  zoom(factor, x = this.width / 2, y = this.height / 2) {
    this.release();
    if (state.mode === "fly") {
      this.walk([0, 0, Math.log(1 / factor) * 0.5 * this.size]);
      return;
    }
    const before = state.mode === "top" ? this.extent : this.distance;
    const after = m.clamp(before * factor, 0.003 * this.size, 20 * this.size);
    if (state.mode === "top") {
      const k = (before - after) / this.height;
      this.target = m.add(this.target, [(x - this.width / 2) * k, -(y - this.height / 2) * k, 0]);
      this.extent = after;
    } else this.distance = after;
  }

  /** Moves along the camera's own axes: right, up, ahead. @param {m.Vec3} by */
  walk([right, up, ahead]) {
    this.release();
    const pose = this.onFloor();
    const along = m.add(m.scale(m.axis(pose, 0), right), m.scale(m.axis(pose, 2), ahead));
    this.target = m.add(this.target, m.add(along, [0, 0, up]));
  }

  /** The ray through a place of the canvas, in the floor's frame. @param {number} x @param {number} y
   * @returns {{from: m.Vec3, along: m.Vec3}} */
  ray(x, y) {
    const lens = this.lens();
    const pose = m.multiply(m.invertRigid(this.floor), this.pose());
    const along = m.turn(pose, [(x - lens.cx) / lens.fx, (y - lens.cy) / lens.fy, 1]);
    return { from: m.position(pose), along };
  }

  /** Where a place of the canvas lies on a level of the floor's frame. @param {number} x @param {number} y
   * @param {number} z @returns {m.Vec3 | null} */
  onLevel(x, y, z) {
    const { from, along } = this.ray(x, y);
    const far = (z - from[2]) / along[2];
    return far > 0 && far < 1e4 * this.size ? m.add(from, m.scale(along, far)) : null;
  }
}

// Vectors and 4x4 matrices. Matrices are column-major arrays of 16, as WebGL takes them.

/** @typedef {[number, number, number]} Vec3 */
/** @typedef {number[]} Mat4 */

/** @type {(a: Vec3, b: Vec3) => Vec3} */
export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
/** @type {(a: Vec3, b: Vec3) => Vec3} */
export const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
/** @type {(a: Vec3, k: number) => Vec3} */
export const scale = (a, k) => [a[0] * k, a[1] * k, a[2] * k];
/** @type {(a: Vec3, b: Vec3) => number} */
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/** @type {(a: Vec3, b: Vec3) => Vec3} */
export const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
/** @type {(a: Vec3) => number} */
export const length = (a) => Math.hypot(a[0], a[1], a[2]);
/** @type {(a: Vec3) => Vec3} */
export const normalize = (a) => scale(a, 1 / (length(a) || 1));
/** @type {(a: number, low: number, high: number) => number} */
export const clamp = (a, low, high) => Math.min(high, Math.max(low, a));
/** @type {(a: number, b: number, share: number) => number} */
export const mix = (a, b, share) => a + (b - a) * share;

/** @returns {Mat4} */
export const identity = () => [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

/** The matrix with these columns: three axes and a position.
 * @param {Vec3} x @param {Vec3} y @param {Vec3} z @param {Vec3} at @returns {Mat4} */
export const fromColumns = (x, y, z, at) => [...x, 0, ...y, 0, ...z, 0, ...at, 1];

/** @param {number[][]} rows @returns {Mat4} */
export const fromRows = (rows) =>
  Array.from({ length: 16 }, (_, k) => rows[k % 4][Math.floor(k / 4)]);

/** @param {Mat4} m @returns {number[][]} */
export const toRows = (m) =>
  Array.from({ length: 4 }, (_, r) => Array.from({ length: 4 }, (_, c) => m[c * 4 + r]));

/** @param {Mat4} a @param {Mat4} b @returns {Mat4} */
export function multiply(a, b) {
  const product = new Array(16).fill(0);
  for (let c = 0; c < 4; c++)
    for (let r = 0; r < 4; r++)
      for (let k = 0; k < 4; k++) product[c * 4 + r] += a[k * 4 + r] * b[c * 4 + k];
  return product;
}

/** The inverse of a rotation followed by a translation.
 * @param {Mat4} m @returns {Mat4} */
export function invertRigid(m) {
  const [x, y, z, t] = [0, 4, 8, 12].map((k) => /** @type {Vec3} */ (m.slice(k, k + 3)));
  return [x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0,
    -dot(x, t), -dot(y, t), -dot(z, t), 1];
}

/** @param {Mat4} m @param {Vec3} p @returns {Vec3} */
export const transform = (m, p) => add(turn(m, p), position(m));
/** @param {Mat4} m @param {Vec3} v @returns {Vec3} */
export const turn = (m, v) => [
  m[0] * v[0] + m[4] * v[1] + m[8] * v[2],
  m[1] * v[0] + m[5] * v[1] + m[9] * v[2],
  m[2] * v[0] + m[6] * v[1] + m[10] * v[2],
];
/** @param {Mat4} m @param {0 | 1 | 2} k @returns {Vec3} */
export const axis = (m, k) => /** @type {Vec3} */ (m.slice(4 * k, 4 * k + 3));
/** @param {Mat4} m @returns {Vec3} */
export const position = (m) => /** @type {Vec3} */ (m.slice(12, 15));

/** From a camera's frame (OpenCV: x right, y down, z forward) to clip space.
 * @param {Lens} lens @param {number} near @param {number} far @returns {Mat4}
 * @typedef {{width: number, height: number, fx: number, fy: number, cx: number, cy: number}} Lens */
export function projection({ width, height, fx, fy, cx, cy }, near, far) {
  const depth = far - near;
  return [
    (2 * fx) / width, 0, 0, 0,
    0, (-2 * fy) / height, 0, 0,
    (2 * cx + 1) / width - 1, 1 - (2 * cy + 1) / height, (far + near) / depth, 1,
    0, 0, (-2 * far * near) / depth, 0,
  ];
}

/** Between two rigid motions: positions on a line, axes by the shortest turn, nearly.
 * @param {Mat4} a @param {Mat4} b @param {number} share @returns {Mat4} */
export function between(a, b, share) {
  const blend = (/** @type {Vec3} */ u, /** @type {Vec3} */ v) =>
    /** @type {Vec3} */ (u.map((x, k) => mix(x, v[k], share)));
  const z = normalize(blend(axis(a, 2), axis(b, 2)));
  const down = blend(axis(a, 1), axis(b, 1));
  const x = normalize(cross(down, z));
  if (length(cross(down, z)) < 1e-6) return share < 0.5 ? a : b;
  return fromColumns(x, cross(z, x), z, blend(position(a), position(b)));
}

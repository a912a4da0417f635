// What the page knows and shows. Whoever changes it says so; whoever shows it listens.

/** @typedef {{words: string, edit: string}} EditEntry */
/** @typedef {{id: number, name: string, points: number, score: number, photos: string[], colour: number[],
 *   mean_colour: number[], size: number[], floor_box: number[][]}} Instance */
/** @typedef {{intrinsics: import("./math.js").Lens, cam_to_world: number[][]}} Camera */
/** @typedef {{name: string, camera: Camera}} Photo */
/** @typedef {{name: string, folder: string, version: string, scale: string, floor_to_world: number[][],
 *   points: {count: number, chunk: number, record: number}, floor_box: number[][], photos: Photo[],
 *   held_out: Photo[], instances: Instance[], edits: EditEntry[], undone: number, not_editable?: string}} Scene */
/** @typedef {"orbit" | "fly" | "top"} CameraMode */
/** @typedef {"photo" | "instance" | "confidence" | "origin"} ColourMode */
/** @typedef {"look" | "move" | "lasso"} Tool */

export const state = {
  /** @type {Scene | null} */
  scene: null,
  /** Ids, in the order in which they were selected. @type {Set<number>} */
  selected: new Set(),
  /** @type {Set<number>} */
  hidden: new Set(),
  /** Those that alone are shown, if any. @type {Set<number> | null} */
  isolated: null,
  /** @type {CameraMode} */
  mode: "orbit",
  /** @type {ColourMode} */
  colours: "photo",
  /** @type {Tool} */
  tool: "look",
  cameras: true,
  /** Whether surfaces are shown from behind, too. */
  behind: false,
  strip: true,
  /** Whether the server is at work on an edit. */
  busy: false,
  /** Points that have arrived, of all. */
  loaded: 0,
};

const news = new EventTarget();

/** @param {"scene" | "selection" | "view" | "loaded" | "busy"} what */
export const tell = (what) => news.dispatchEvent(new Event(what));
/** @param {string} kinds separated by spaces @param {() => void} listener */
export function listen(kinds, listener) {
  for (const kind of kinds.split(" ")) news.addEventListener(kind, listener);
}

/** @param {number} id */
export const instance = (id) => state.scene?.instances.find((one) => one.id === id);
/** The instances that are selected, the first first. */
export const selection = () =>
  [...state.selected].map(instance).filter((one) => one !== undefined);

/** Whether an instance's points are shown. @param {number} id */
export const isShown = (id) =>
  !state.hidden.has(id) && (state.isolated === null || state.isolated.has(id));

/** @param {number | null} id @param {boolean} [adding] */
export function select(id, adding = false) {
  if (!adding) state.selected = new Set(id ? [id] : []);
  else if (id && !state.selected.delete(id)) state.selected.add(id);
  tell("selection");
}

/** Takes a scene over that the server described. @param {Scene} scene */
export function setScene(scene) {
  state.scene = scene;
  const known = new Set(scene.instances.map((one) => one.id));
  for (const set of [state.selected, state.hidden]) for (const id of set) if (!known.has(id)) set.delete(id);
  if (state.isolated && ![...state.isolated].some((id) => known.has(id))) state.isolated = null;
  tell("scene");
}

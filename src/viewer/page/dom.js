// Elements, and what is said in passing.

/** An element. `on…` are listeners, `class` and others attributes; false and null leave one out.
 * @param {string} name @param {Record<string, any>} [attributes] @param {...(Node | string | null | undefined | false)} children
 * @returns {any} */
export function el(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (value === true) element.setAttribute(key, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(key, String(value));
  }
  element.append(...children.filter((child) => child instanceof Node || Boolean(child)).map((child) => /** @type {Node | string} */ (child)));
  return element;
}

/** @param {string} selector @returns {any} */
export const find = (selector) => document.querySelector(selector);

const SVG = "http://www.w3.org/2000/svg";
/** Strokes on a grid of 24. @type {Record<string, string>} */
const ICONS = {
  eye: "M2 12s3.6-7 10-7 10 7 10 7-3.6 7-10 7S2 12 2 12Zm10 3a3 3 0 1 0 0-6 3 3 0 0 0 0 6Z",
  hidden: "M4 4l16 16M9.5 5.3A10 10 0 0 1 12 5c6.400 0 10 7 10 7a17 17 0 0 1-3 3.800M6 7.500A17 17 0 0 0 2 12s3.600 7 10 7a10 10 0 0 0 4.500-1",
  undo: "M4 9h10a6 6 0 0 1 0 12h-3M4 9l5-5M4 9l5 5",
  redo: "M20 9H10a6 6 0 0 0 0 12h3M20 9l-5-5M20 9l-5 5",
  camera: "M3 8h4l2-3h6l2 3h4v11H3Zm9 8.500a3.500 3.500 0 1 0 0-7 3.500 3.500 0 0 0 0 7Z",
  strip: "M3 6h18v12H3Zm6 0v12m6-12v12",
  move: "M12 3v18M3 12h18M12 3l-3 3m3-3 3 3M12 21l-3-3m3 3 3-3M3 12l3-3m-3 3 3 3M21 12l-3-3m3 3-3 3",
  lasso: "M12 4c5 0 9 2.500 9 6s-4 6-9 6-9-2.500-9-6 4-6 9-6Zm-4 11c-2 2-1 5 2 5",
  help: "M9 9a3 3 0 1 1 4.500 2.600c-1 .6-1.500 1.200-1.500 2.400m0 3v.5M12 22a10 10 0 1 0 0-20 10 10 0 0 0 0 20Z",
  close: "M5 5l14 14M19 5 5 19",
  film: "M3 5h18v14H3Zm4 0v14M17 5v14M3 12h18M3 8.500h4M3 15.500h4m10-7h4m-4 7h4",
  box: "M4 8l8-4 8 4v9l-8 4-8-4Zm0 0 8 4 8-4m-8 4v9",
  bin: "M4 7h16M9 7V4h6v3m-8 0 1 13h8l1-13",
};

/** @param {string} name */
export function icon(name) {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "0 0 24 24");
  svg.setAttribute("aria-hidden", "true");
  svg.setAttribute("class", "icon");
  const path = document.createElementNS(SVG, "path");
  path.setAttribute("d", ICONS[name]);
  svg.append(path);
  return svg;
}

/** Says what went wrong, and what to do. @param {unknown} error */
export function complain(error) {
  const { problem, remedy } = /** @type {any} */ (error);
  say(problem ?? `the page made a mistake: ${error}`, remedy ?? "reload it", true);
  if (!problem) console.error(error);
}

/** @param {string} text @param {string} [more] @param {boolean} [bad] */
export function say(text, more = "", bad = false) {
  const close = () => toast.remove();
  const toast = el("div", { class: bad ? "toast bad" : "toast", role: bad ? "alert" : "status" },
    el("p", {}, el("strong", {}, text), more && el("span", {}, more)),
    el("button", { class: "quiet", "aria-label": "Dismiss", onclick: close }, icon("close")));
  find("#toasts").append(toast);
  setTimeout(close, bad ? 12000 : 4000);
}

/** @param {number} count */
export const readable = (count) => count.toLocaleString("en");

/** @param {number} bytes */
export const size = (bytes) => bytes < 1e6 ? `${Math.max(1, Math.round(bytes / 1e3))} kB`
  : bytes < 1e9 ? `${(bytes / 1e6).toFixed(1)} MB` : `${(bytes / 1e9).toFixed(1)} GB`;

/** Seconds in words. @param {number} seconds */
export function duration(seconds) {
  if (seconds < 90) return `${Math.round(seconds)} s`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
  return `${(seconds / 3600).toFixed(1)} h`;
}

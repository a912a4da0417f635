// Rendering: what is asked for, how far it is, and what came of it.

import { get, send } from "./api.js";
import { complain, el, find, icon, say } from "./dom.js";
import { MAKING, JobCard, goesOn, listenToJobs } from "./jobs.js";
import { address } from "./photos.js";
import { state } from "./store.js";

/** @typedef {import("./jobs.js").Job} Job */
/** @typedef {{id: number, title: string, completion: string, views: {name: string, photo?: number, done: boolean}[], video: boolean}} Entry */

/** @type {Job[]} */
let jobs = [];
/** @type {Entry[]} */
let entries = [];
/** @type {{id: string, title: string, problem?: string}[]} */
let completions = [];
/** By the job's id. @type {Map<number, JobCard>} */
const cards = new Map();
/** Corners of a camera path. @type {import("./store.js").Camera[]} */
const keys = [];
/** @type {import("./camera.js").View} */
let view;

/** Asks what there is, and listens for what happens. @param {import("./camera.js").View} from */
export async function start(from) {
  view = from;
  listenToJobs((all) => news(all.filter((job) => job.id !== MAKING)).catch(complain));
  [completions, entries] = await Promise.all([get("/api/completions"), get("/api/gallery")]);
  build();
}

/** @param {Job[]} now */
async function news(now) {
  const before = new Map(jobs.map((job) => [job.id, job]));
  jobs = now;
  const steps = now.some((job) => before.get(job.id)?.done !== job.done || before.get(job.id)?.state !== job.state);
  for (const job of now) {
    const was = before.get(job.id);
    if (!was || was.state === job.state) continue;
    if (job.state === "done") say(`Rendered ${job.title}`, "It is in the gallery");
    if (job.state === "failed") complain({ problem: `Rendering ${job.title} failed: ${job.problem}`, remedy: "" });
  }
  drawJobs();
  if (steps) {
    entries = await get("/api/gallery");
    drawGallery();
  }
}

/** Adds the current view to the path. */
export function addKey() {
  if (!find("#ask")) return;
  keys.push(view.camera());
  find("#from").value = "path";
  choose();
}

/** What the form asks for. */
function request() {
  const from = /** @type {"view" | "photo" | "path" | "orbit"} */ (find("#from").value);
  const number = (/** @type {string} */ id) => Math.round(Number(find(id).value) || 0);
  const cameras = {
    view: () => ({ view: view.camera() }),
    photo: () => ({ photos: [find("#at").value] }),
    path: () => ({ path: { keys, between: number("#between") } }),
    orbit: () => ({ orbit: { views: number("#views") } }),
  }[from]();
  const how = find("#completion").value;
  const steps = number("#steps");
  const completion = how === "see3d"
    ? { see3d: { quality: find("#quality").value, ...(steps ? { steps } : {}) } } : how;
  const width = number("#width");
  return { cameras, completion, ...(width ? { width } : {}) };
}

function build() {
  /** @param {string} label @param {any} control @param {string} [when] */
  const field = (label, control, when = "") => el("label", { class: "field line", "data-when": when }, el("span", {}, label), control);
  const option = (/** @type {any} */ value, text = value, disabled = false) => el("option", { value, disabled }, text);
  const photos = [...(state.scene?.photos ?? []), ...(state.scene?.held_out ?? [])];
  const missing = completions.find(({ problem }) => problem);
  const form = el("form", { id: "ask", onsubmit: begin, oninput: choose },
    field("From", el("select", { id: "from" }, option("view", "The current view"), option("photo", "A photo's camera"),
      option("path", "A path"), option("orbit", "Around the room"))),
    field("Photo", el("select", { id: "at" }, ...photos.map(({ name }) => option(name))), "photo"),
    el("div", { class: "keys", "data-when": "path" },
      el("p", { id: "keys", class: "quiet-note" }),
      el("div", { class: "actions" },
        el("button", { type: "button", id: "add-key", title: "Add the current view (K)", onclick: addKey }, "Add this view"),
        el("button", { type: "button", onclick: () => { keys.pop(); choose(); } }, "Drop the last"))),
    field("Views in between", el("input", { id: "between", type: "number", min: 0, max: 500, value: 24 }), "path"),
    field("Views", el("input", { id: "views", type: "number", min: 1, max: 500, value: 24 }), "orbit"),
    field("Width, pixels", el("input", { id: "width", type: "number", min: 16, max: 4096, value: 640 })),
    field("Completed by", el("select", { id: "completion" }, ...completions.map(({ id, title, problem }) =>
      option(id, problem ? `${title} (no weights)` : title, Boolean(problem))))),
    field("Sampler", el("select", { id: "quality" }, option("fast", "Fast"), option("exact", "Exact: See3D's own")), "see3d"),
    field("Steps", el("input", { id: "steps", type: "number", min: 0, max: 500, placeholder: "as usual" }), "see3d"),
    missing && el("details", {}, el("summary", {}, `${missing.title} is not available`), el("p", { class: "quiet-note" }, missing.problem)),
    el("p", { id: "estimate", class: "quiet-note", role: "status" }),
    el("div", { class: "actions" },
      el("button", { type: "button", id: "ask-estimate", onclick: estimate }, "Estimate"),
      el("button", { class: "primary", id: "begin" }, "Render")));
  find("#render").replaceChildren(form, el("div", { id: "jobs", "aria-live": "polite" }), el("div", { id: "gallery" }));
  choose();
  drawJobs();
  drawGallery();
}

/** Shows the fields that what is chosen needs. */
function choose() {
  if (!find("#ask")) return;
  const chosen = [find("#from").value, find("#completion").value];
  for (const field of find("#ask").querySelectorAll("[data-when]")) {
    field.hidden = field.dataset.when !== "" && !chosen.includes(field.dataset.when);
  }
  find("#keys").textContent = keys.length === 0
    ? "Look from where the path begins and add that view; then the next."
    : `${keys.length} view${keys.length > 1 ? "s" : ""} on the path.`;
  find("#estimate").textContent = "";
}

async function estimate() {
  try {
    const { estimate } = await send("/api/estimate", request());
    find("#estimate").textContent = estimate ?? "";
  } catch (error) {
    complain(error);
  }
}

/** @param {Event} event */
async function begin(event) {
  event.preventDefault();
  const button = find("#begin");
  button.disabled = true;
  try {
    await send("/api/jobs", request());
  } catch (error) {
    complain(error);
  } finally {
    button.disabled = false;
  }
}

function drawJobs() {
  const place = find("#jobs");
  if (!place) return;
  const shown = jobs.filter((job) => goesOn(job) || job.state === "failed").reverse();
  for (const id of cards.keys()) if (!shown.some((job) => job.id === id)) cards.delete(id);
  const wanted = shown.map((job) => {
    const card = cards.get(job.id) ?? new JobCard();
    cards.set(job.id, card);
    return card.show(job);
  });
  // What is taken out and put back loses the focus.
  if (wanted.length !== place.children.length || wanted.some((card, k) => card !== place.children[k])) place.replaceChildren(...wanted);
}

/** @param {Entry} entry @param {string} name @param {string} kind */
const picture = (entry, name, kind) => `/api/gallery/${entry.id}/${encodeURIComponent(name)}/${kind}`;

function drawGallery() {
  const place = find("#gallery");
  if (!place) return;
  const filled = entries.filter((entry) => !jobs.some((job) => job.id === entry.id && goesOn(job)) ||
    entry.views.some(({ done }) => done)).reverse();
  place.replaceChildren(...(filled.length ? [el("h2", {}, "Gallery")] : []), ...filled.map((entry) => {
    const done = entry.views.filter((one) => one.done);
    const going = jobs.some((job) => job.id === entry.id && goesOn(job));
    const count = done.length < entry.views.length ? `${done.length} of ${entry.views.length}` : entry.views.length > 1 ? `${done.length}` : "";
    const more = !going && done.length < entry.views.length;
    return el("figure", { class: "rendered", "data-entry": entry.id },
      el("button", { class: "thumb", "aria-label": `Show ${entry.title}`, disabled: done.length === 0, onclick: () => show(entry, done, 0) },
        done.length > 0 && el("img", { src: picture(entry, done[done.length - 1].name, "completed"), alt: "", loading: "lazy" })),
      el("figcaption", {}, el("span", {}, entry.title, count && ` · ${count}`), el("small", {}, entry.completion),
        entry.video && el("a", { class: "link", href: `/api/gallery/${entry.id}/video`, download: `${entry.title}.mp4` }, "Video"),
        more && el("button", { class: "link", onclick: () => send(`/api/gallery/${entry.id}/continue`).catch(complain) }, "Continue"),
        el("button", { class: "tool", "aria-label": `Delete ${entry.title}`, title: "Delete", disabled: going, onclick: () => drop(entry) }, icon("bin"))));
  }));
}

/** @param {Entry} entry */
async function drop(entry) {
  try {
    await send(`/api/gallery/${entry.id}`, null, "DELETE");
    entries = await get("/api/gallery");
    drawGallery();
  } catch (error) {
    complain(error);
  }
}

/** Shows a rendered view with a slider between before and after.
 * @param {Entry} entry @param {Entry["views"]} views @param {number} k */
function show(entry, views, k) {
  const dialog = find("#show");
  const { name, photo } = views[k];
  const close = () => dialog.close();
  const after = el("img", { src: picture(entry, name, "completed"), alt: `${name}, completed` });
  const before = el("img", { class: "before", alt: `${name}, before`, src: picture(entry, name, "projection") });
  const line = el("i", { class: "line" });
  const cut = (/** @type {number} */ share) => {
    before.style.clipPath = `inset(0 ${100 - share}% 0 0)`;
    line.style.left = `${share}%`;
  };
  const sources = el("select", { "aria-label": "Compare with", onchange: (/** @type {any} */ event) => {
    before.src = event.target.value === "photo" ? address(photo ?? 0) : picture(entry, name, "projection");
  } }, el("option", { value: "projection" }, "The points alone"),
    photo !== undefined && photo < (state.scene?.photos.length ?? 0) && el("option", { value: "photo" }, "The photo"));
  const to = (/** @type {number} */ next) => el("button", { disabled: !views[next], "aria-label": next < k ? "Previous" : "Next",
    onclick: () => show(entry, views, next) }, next < k ? "‹" : "›");
  cut(50);
  dialog.replaceChildren(
    el("header", {}, el("h2", {}, entry.title === name ? name : `${entry.title}: ${name}`),
      el("button", { class: "tool", "aria-label": "Close", onclick: close }, icon("close"))),
    el("div", { class: "picture compare" }, after, before, line,
      el("input", { type: "range", min: 0, max: 100, step: 0.5, value: 50, "aria-label": "Before and after",
        oninput: (/** @type {any} */ event) => cut(Number(event.target.value)) })),
    el("footer", {}, el("label", { class: "field" }, el("span", {}, "Left"), sources), el("span", { class: "space" }),
      views.length > 1 && to(k - 1), views.length > 1 && to(k + 1),
      el("a", { class: "button", href: picture(entry, name, "completed"), download: `${name}.png` }, "Download")));
  if (dialog.open) dialog.querySelector(".compare input").focus();
  else dialog.showModal();
}

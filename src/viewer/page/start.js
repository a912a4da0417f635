// The page where there is no scene yet: files are dropped, and become one.

import { get, send } from "./api.js";
import { complain, el, find, size } from "./dom.js";
import { Files, filesOf } from "./files.js";
import { JobCard, MAKING, goesOn, listenToJobs, percent } from "./jobs.js";

/** @typedef {{id: string, title: string, problem?: string}} Mean */
/** @typedef {{folder: string, limits: import("./files.js").Limits, uploads: import("./files.js").Upload[],
 *   means: {reconstructor: Mean, segmenters: Mean[], dtypes: string[]}}} Start */

/** @type {Start} */
let start;
/** @type {Files} */
let files;
/** @type {import("./jobs.js").Job | undefined} */
let job;
const card = new JobCard();

addEventListener("unhandledrejection", (event) => complain(event.reason));

const isMaking = () => job !== undefined && goesOn(job);

/** Says which weights are lacking, and what can be done about it. */
function drawMeans() {
  const { reconstructor, segmenters, dtypes } = start.means;
  const lacking = find("#lacking");
  lacking.hidden = !reconstructor.problem;
  lacking.replaceChildren(
    el("h2", {}, "MV-DUSt3R has no weights here"),
    el("p", {}, "Without them, photos cannot become a scene. tid3r brings no weights and fetches none: "),
    el("p", { class: "quiet-note" }, reconstructor.problem),
    el("button", { type: "button", onclick: () => look().catch(complain) }, "Look again"));
  const chosen = find("#segmenter").value;
  const ready = segmenters.filter(({ problem }) => !problem);
  find("#segmenter").replaceChildren(...segmenters.map(({ id, title, problem }) =>
    el("option", { value: id, disabled: Boolean(problem) }, problem ? `${title} (no weights)` : title)));
  find("#segmenter").value = ready.some(({ id }) => id === chosen) ? chosen : ready[0].id;
  for (const option of find("#dtype").options) option.hidden = option.disabled = !dtypes.includes(option.value);
  const missing = segmenters.find(({ problem }) => problem);
  find("#no-network").hidden = !missing;
  if (missing) {
    find("#no-network summary").textContent = "MobileSAMv2, which tells objects apart better, has no weights here";
    find("#no-network p").textContent = missing.problem;
  }
}

/** Asks again which weights there are. */
async function look() {
  start = await get("/api/start");
  drawMeans();
  draw();
}

/** Shows what can be done now. */
function draw() {
  const making = isMaking(), failed = job?.state === "failed", { arrived, coming } = files;
  document.body.toggleAttribute("data-making", making);
  for (const id of ["#drop", "#choices"]) find(id).hidden = making;
  find("#making").hidden = !making && !failed;
  find("#outcome").hidden = making || job?.state !== "cancelled";
  find("#outcome").textContent = "Cancelled. The photos are still here, and what was finished is not done again.";
  const bytes = arrived.reduce((all, { upload }) => all + (upload?.bytes ?? 0), 0);
  const there = arrived.length === 0 ? "Nothing is here yet" : `${arrived.length} file${arrived.length > 1 ? "s" : ""}, ${size(bytes)}`;
  find("#count").textContent = coming ? `${there}; ${coming} on their way` : `${there}.`;
  find("#begin").disabled = making || coming > 0 || arrived.length === 0 || Boolean(start.means.reconstructor.problem);
  find("#begin").textContent = failed ? "Try again" : "Make the scene";
  document.title = making ? `${percent(/** @type {any} */ (job))} % · tid3r` : "New scene · tid3r";
  // The server says which part it is of how many; the page has a picture for that.
  const [, part = "0", task = job?.task ?? ""] = /^(\d)\/\d (.*)/.exec(job?.task ?? "") ?? [];
  // For who does not see the card: each task once.
  const now = making ? task : failed ? job?.problem ?? "" : "";
  if (find("#now").textContent !== now) find("#now").textContent = now;
  if (!job || find("#making").hidden) return;
  card.show({ ...job, task });
  [...find("#parts").children].forEach((one, k) => {
    one.classList.toggle("done", k + 1 < Number(part));
    if (k + 1 === Number(part)) one.setAttribute("aria-current", "step");
    else one.removeAttribute("aria-current");
  });
}

/** @param {import("./jobs.js").Job[]} jobs */
function news(jobs) {
  const was = job;
  job = jobs.find(({ id }) => id === MAKING);
  if (job?.state === "done") location.replace("/");
  const ended = was && goesOn(was) && !isMaking();
  draw();
  if (ended) find("#begin").focus();
}

/** @param {Event} event */
async function begin(event) {
  event.preventDefault();
  find("#begin").disabled = true;
  try {
    await send("/api/start", { segmenter: find("#segmenter").value, dtype: find("#dtype").value });
  } catch (error) {
    complain(error);
    draw();
  }
}

function listenToDrops() {
  const drop = find("#drop"), chosen = find("#chosen");
  chosen.addEventListener("change", () => {
    files.add([...chosen.files]);
    chosen.value = "";
  });
  // All of the page is meant: what misses the zone must not replace the page.
  for (const kind of ["dragenter", "dragover"]) addEventListener(kind, (event) => { event.preventDefault(); drop.classList.add("over"); });
  addEventListener("dragleave", (event) => { if (!event.relatedTarget) drop.classList.remove("over"); });
  addEventListener("drop", (event) => {
    event.preventDefault();
    drop.classList.remove("over");
    if (event.dataTransfer && !isMaking()) filesOf(event.dataTransfer).then((found) => files.add(found)).catch(complain);
  });
  addEventListener("beforeunload", (event) => { if (files.coming) event.preventDefault(); });
}

async function run() {
  find("#making").append(card.element);
  try {
    start = await get("/api/start");
  } catch (error) {
    // The scene was made since the page was sent.
    if (/** @type {any} */ (error).status === 409) location.reload();
    throw error;
  }
  files = new Files(find("#files"), start.limits, draw);
  find("#folder").textContent = start.folder;
  find("#name").textContent = "new scene";
  listenToDrops();
  find("#choices").addEventListener("submit", begin);
  drawMeans();
  files.adopt(start.uploads);
  listenToJobs(news);
  // Weights may have been fetched meanwhile.
  addEventListener("focus", () => { if (start.means.reconstructor.problem) look().catch(complain); });
}

run().catch(complain);

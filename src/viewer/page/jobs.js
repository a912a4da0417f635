// Jobs of the server, as the pages show them.

import { send } from "./api.js";
import { complain, duration, el } from "./dom.js";

/** @typedef {{id: number, title: string, state: string, task: string, done: number, total: number, seconds: number,
 *   task_seconds: number, notes: string[], previews?: {name: string, number: number}[], problem?: string}} Job */

/** The job that makes a scene of photos; all others are renderings. */
export const MAKING = 0;

/** @param {Job} job */
export const goesOn = (job) => job.state === "queued" || job.state === "running";
/** How much of its task is done, per cent. @param {Job} job */
export const percent = (job) => (job.total ? Math.round((100 * job.done) / job.total) : 0);

/** Tells of all jobs, now and whenever anything about one has changed. @param {(jobs: Job[]) => unknown} listener */
export function listenToJobs(listener) {
  new EventSource("/api/events").addEventListener("jobs", (event) => listener(JSON.parse(event.data)));
}

/** A job that goes on or has failed. Its elements stay while it changes: who is at a button stays there. */
export class JobCard {
  constructor() {
    this.title = el("strong");
    this.cancel = el("button", { type: "button", class: "cancel", onclick: () => this.end() }, "Cancel");
    this.words = el("p");
    this.bar = el("i");
    this.progress = el("div", { class: "progress", role: "progressbar", "aria-valuemin": 0, "aria-valuemax": 100 }, this.bar);
    this.notes = el("div", { class: "notes" });
    this.previews = el("div", { class: "previews" });
    this.told = "";
    this.element = el("article", {}, el("header", {}, this.title, this.cancel), this.words, this.progress, this.previews, this.notes);
  }

  /** @param {Job} job */
  show(job) {
    this.job = job;
    const going = goesOn(job), share = percent(job);
    const left = job.state === "running" && job.done > 0 ? (job.task_seconds * (job.total - job.done)) / job.done : 0;
    const words = { queued: "waits", running: job.task || "begins", failed: job.problem }[job.state] ?? "";
    this.element.className = `job ${job.state}`;
    this.element.dataset.job = String(job.id);
    this.title.textContent = job.title;
    this.words.textContent = words + (left > 1 ? `, ${duration(left)} left` : "");
    this.bar.style.width = `${share}%`;
    this.progress.setAttribute("aria-valuenow", String(share));
    this.progress.setAttribute("aria-label", job.title);
    this.progress.hidden = this.cancel.hidden = !going;
    this.showPreviews(job.previews ?? []);
    const told = job.notes.join("\n");
    if (this.told !== told) {
      this.told = told;
      this.notes.replaceChildren(...job.notes.map((note) => el("p", { class: "quiet-note" }, note)));
    }
    return this.element;
  }

  /** Pictures that take shape. Each is put in the place of the one before once it is there.
   * @param {{name: string, number: number}[]} previews */
  showPreviews(previews) {
    const images = /** @type {HTMLImageElement[]} */ ([...this.previews.children]);
    images.slice(previews.length).forEach((image) => image.remove());
    previews.forEach(({ name, number }, place) => {
      const image = images[place] ?? this.previews.appendChild(el("img"));
      const address = `/api/jobs/${this.job?.id}/preview/${place}/${number}`;
      if (image.dataset.address === address) return;
      image.dataset.address = address;
      const next = new Image();
      next.src = address;
      next.decode().then(() => {
        if (image.dataset.address === address) [image.src, image.alt, image.title] = [next.src, `${name}, as it takes shape`, name];
      }, () => {});
    });
  }

  end() {
    if (this.job) send(`/api/jobs/${this.job.id}/cancel`).catch(complain);
  }
}

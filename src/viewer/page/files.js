// Files that were dropped: sent one after the other, and shown as they arrive.

import { send, sendFile } from "./api.js";
import { complain, el, icon, size } from "./dom.js";

/** @typedef {{id: number, label: string, content: "photo" | "zip" | "video", bytes: number, sha256: string}} Upload */
/** @typedef {{files: number, photo: number, large: number, total: number}} Limits */

/** A file in the list: on its way, there, or refused. */
class Item {
  /** @param {string} label @param {number} bytes @param {(item: Item) => void} remove */
  constructor(label, bytes, remove) {
    this.bytes = bytes;
    /** @type {Upload | null} */
    this.upload = null;
    this.refused = false;
    this.stop = new AbortController();
    this.picture = el("div", { class: "thumb" });
    this.words = el("small", {}, "waits");
    this.bar = el("i");
    this.progress = el("div", { class: "progress", role: "progressbar", "aria-label": `${label}, sent`, "aria-valuemin": 0, "aria-valuemax": 100 }, this.bar);
    this.button = el("button", { type: "button", class: "tool", title: "Remove", "aria-label": `Remove ${label}`, onclick: () => remove(this) }, icon("close"));
    this.element = el("li", {}, this.picture, el("span", { title: label }, label), this.words, this.progress, this.button);
  }

  /** @param {number} share */
  reach(share) {
    this.bar.style.width = `${100 * share}%`;
    this.progress.setAttribute("aria-valuenow", String(Math.round(100 * share)));
    // It is looked at once it is there.
    this.words.textContent = share < 1 ? `${Math.floor(100 * share)} % of ${size(this.bytes)}` : "is looked at";
  }

  /** @param {Upload} upload */
  arrive(upload) {
    this.upload = upload;
    this.element.dataset.upload = String(upload.id);
    this.progress.hidden = true;
    this.words.textContent = size(upload.bytes);
    this.picture.replaceChildren(upload.content === "photo"
      ? el("img", { src: `/api/uploads/${upload.id}/thumbnail?${upload.sha256.slice(0, 8)}`, alt: "", loading: "lazy" })
      : icon(upload.content === "zip" ? "box" : "film"));
  }

  /** @param {unknown} error */
  refuse(error) {
    const { problem, remedy } = /** @type {any} */ (error);
    if (!problem) throw error;
    this.refused = true;
    this.element.classList.add("refused");
    this.element.setAttribute("role", "alert");
    this.progress.hidden = true;
    this.words.textContent = remedy ? `${problem}; ${remedy}` : problem;
  }
}

export class Files {
  /** @param {HTMLElement} list @param {Limits} limits @param {() => void} changed */
  constructor(list, limits, changed) {
    this.list = list;
    this.limits = limits;
    this.changed = changed;
    /** @type {Item[]} */
    this.items = [];
    this.sending = Promise.resolve();
  }

  /** Those that are there. */
  get arrived() { return this.items.filter((item) => item.upload); }
  /** How many are on their way. */
  get coming() { return this.items.filter((item) => !item.upload && !item.refused).length; }

  /** Shows what is there already. @param {Upload[]} uploads */
  adopt(uploads) {
    for (const upload of uploads) this.show(upload.label, upload.bytes).arrive(upload);
    this.changed();
  }

  /** Sends files, in the order of their names. @param {File[]} files */
  add(files) {
    const named = [...files].sort((a, b) => a.name.localeCompare(b.name, "en", { numeric: true }));
    for (const file of named) {
      const item = this.show(file.name, file.size);
      this.sending = this.sending.then(() => this.send(item, file)).catch(complain).then(this.changed);
    }
    this.changed();
  }

  /** @param {string} label @param {number} bytes */
  show(label, bytes) {
    const item = new Item(label, bytes, (item) => this.remove(item).catch(complain));
    this.items.push(item);
    this.list.append(item.element);
    return item;
  }

  /** @param {Item} item @param {File} file */
  async send(item, file) {
    if (item.stop.signal.aborted) return;
    const { files, photo, large } = this.limits;
    const most = file.type.startsWith("image/") ? photo : large;
    try {
      // Said at once, instead of after minutes.
      if (file.size > most) throw { problem: `it has more than ${size(most)}`, remedy: "make it smaller" };
      if (this.arrived.length >= files) throw { problem: `${files} files are there already`, remedy: "put photos into a ZIP file" };
      item.reach(0);
      item.arrive(await sendFile(file, (share) => item.reach(share), item.stop.signal));
      // It was removed in the very moment of its arrival.
      if (item.stop.signal.aborted) await this.remove(item);
    } catch (error) {
      item.refuse(error);
    }
  }

  /** @param {Item} item */
  async remove(item) {
    item.stop.abort();
    if (item.upload) await send(`/api/uploads/${item.upload.id}`, null, "DELETE");
    const next = item.element.nextElementSibling ?? item.element.previousElementSibling;
    this.items = this.items.filter((other) => other !== item);
    item.element.remove();
    /** @type {any} */ (next)?.querySelector("button").focus();
    this.changed();
  }
}

/** The files that something dropped stands for: of folders, what is in them. @param {DataTransfer} dropped */
export async function filesOf(dropped) {
  const entries = [...dropped.items].map((item) => item.webkitGetAsEntry()).filter((entry) => entry !== null);
  /** @type {(entry: any) => Promise<File>} */
  const file = (entry) => new Promise((resolve, reject) => entry.file(resolve, reject));
  /** @type {(entry: any) => Promise<File[]>} */
  const within = async (entry) => {
    if (entry.isFile) return [await file(entry)];
    const reader = entry.createReader(), found = [];
    for (;;) {
      /** @type {any[]} */
      const some = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
      if (some.length === 0) return found;
      // Folders within are left out, as on the command line.
      for (const inner of some) if (inner.isFile && !inner.name.startsWith(".")) found.push(await file(inner));
    }
  };
  return (await Promise.all(entries.map(within))).flat();
}

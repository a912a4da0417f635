// The server; or, in a page that was exported, what it would have said.

/** What the server said it could not do. */
export class Refusal extends Error {
  /** @param {number} status @param {string} problem @param {string} remedy */
  constructor(status, problem, remedy) {
    super(`${problem}; ${remedy}`);
    Object.assign(this, { status, problem, remedy });
  }
}

/** @param {string} path @param {RequestInit} [options] */
async function ask(path, options) {
  let response;
  try {
    response = await fetch(path, options);
  } catch (error) {
    if (/** @type {any} */ (error).name === "AbortError") throw error;
    throw new Refusal(0, "the server cannot be reached", "see whether `tid3r view` still runs");
  }
  if (response.ok) return response;
  const { problem, remedy } = await response.json().catch(() => ({}));
  throw new Refusal(response.status, problem ?? response.statusText, remedy ?? "reload the page");
}

const kept = document.querySelector("#kept");
/** What a page that was exported brings along. @type {{scene: any, photos: string[]} | null} */
const own = kept && JSON.parse(kept.textContent ?? "");
/** Whether there is no server. */
export const offline = own !== null;

/** @param {string} path */
export const get = async (path) => (await ask(path)).json();
/** @param {string} path @param {AbortSignal} [signal] */
export const getBytes = async (path, signal) => (await ask(path, { signal })).arrayBuffer();

export const getScene = async () => own?.scene ?? get("/api/scene");

/** The points of a chunk. @param {string} version @param {number} chunk @param {AbortSignal} signal */
export async function getChunk(version, chunk, signal) {
  if (!offline) return getBytes(`/api/cloud/${version}/${chunk}`, signal);
  const text = document.querySelectorAll("script.cloud")[chunk].textContent ?? "";
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  // The picture fills meanwhile.
  await new Promise((resolve) => setTimeout(resolve));
  return bytes.buffer;
}

/** Where a photo is. @param {string | undefined} version @param {number} index */
export const photoAddress = (version, index) => own?.photos[index] ?? `/api/photos/${version}/${index}`;
/** Sends a file. @param {File} file @param {(share: number) => void} tell how much has been sent
 * @param {AbortSignal} signal @returns {Promise<any>} what became of it */
export function sendFile(file, tell, signal) {
  const request = new XMLHttpRequest();
  request.open("POST", `/api/uploads/${encodeURIComponent(file.name)}`);
  request.setRequestHeader("Content-Type", "application/octet-stream");
  request.responseType = "json";
  request.upload.onprogress = ({ loaded, total }) => tell(total ? loaded / total : 0);
  signal.addEventListener("abort", () => request.abort());
  return new Promise((resolve, reject) => {
    const refuse = (/** @type {string} */ problem, /** @type {string} */ remedy) => reject(new Refusal(request.status, problem, remedy));
    request.onload = () => {
      const { problem = "the server takes no file", remedy = "reload the page" } = request.response ?? {};
      if (request.status === 200) resolve(request.response);
      else refuse(problem, remedy);
    };
    request.onerror = () => refuse("the connection broke off", "see whether `tid3r view` still runs, and send it again");
    request.onabort = () => refuse("it was not sent", "");
    request.send(file);
  });
}

/** @param {string} path @param {unknown} content @param {string} [method] */
export async function send(path, content = null, method = "POST") {
  const headers = { "Content-Type": "application/json" };
  const response = await ask(path, { method, headers, body: JSON.stringify(content) });
  return response.status === 204 ? null : response.json();
}

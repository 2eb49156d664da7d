// Exports of the page: a picture, its camera, the command that renders it, and the copying of texts.

import { address } from "./stream.js";

/** Makes the browser save a file. */
function download(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

async function file(name, fields) {
  const response = await fetch(address(name, fields), { cache: "no-store" });
  if (!response.ok) throw new Error(await response.text());
  return response.blob();
}

/** Replaces characters of a name that are unsafe in a file name. */
const slug = (name) => name.replace(/[^\p{L}\p{N}._-]+/gu, "-").slice(0, 60) || "view";

/** Saves the picture of this view, without loss, as `stlfr render` renders it. */
export async function savePicture(state, size, method) {
  const [w, h] = size;
  const blob = await file("picture", { ...state.query(), w, h, method, level: "saved" });
  download(blob, `${slug(state.scene.name)}-${state.t.toFixed(4)}s-${method}.png`);
}

/** Saves the camera of this view, as `stlfr render --camera` reads it. */
export async function saveCamera(state, [w, h]) {
  download(await file("view.json", { ...state.query(), w, h }), "view.json");
}

/** Quotes a word for a shell. */
const quoted = (word) => (/^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`);

/** The command-line options with `method` as the value of `flag`. Without a method, they are unchanged. */
function withMethod(options, flag, method) {
  if (!method) return options;
  const own = options.filter((word, k) => word !== flag && options[k - 1] !== flag && !word.startsWith(`${flag}=`));
  return [...own, flag, method];
}

/** The command line of `stlfr render` that renders the same picture. */
export function command(state) {
  const { folder } = state.scene;
  const sync = state.left === "lfr" ? "nearest" : state.sync;
  const options = withMethod(withMethod(state.scene.options, "--sync", sync), "--proxy", state.proxy);
  const words = ["stlfr", "render", folder, ...options, "--camera", "view.json", "--time", String(state.t), "-o", "view.png"];
  return words.map(quoted).join(" ");
}

/** The command line of `stlfr view` that opens the page again with the same view, in any run of the program. */
export function returnCommand(state) {
  const { folder, options } = state.scene;
  return ["stlfr", "view", folder, ...options, "--at", state.link()].map(quoted).join(" ");
}

/** Copies a text to the clipboard; returns whether the browser allowed it. */
export async function copy(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    return false;
  }
}

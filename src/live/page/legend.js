// The legend: the colours of the cameras or of depths, and the blending weights or the depth under the pointer.

import { address } from "./stream.js";

/** Smallest blending weight, from 0 to 1, that is shown as a number. Smaller weights are shown as a dash. */
const LEAST = 0.005;
const UNPOINTED = "Point at the picture for the depth there.";

function element(name, properties, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

const percent = (weight) => (weight < LEAST ? "–" : `${Math.round(100 * weight)} %`);
const metres = (depth) => (Number.isFinite(depth) ? `${depth.toPrecision(3)} m` : "∞");

export class Legend {
  constructor(card, scene) {
    Object.assign(this, { card, scene });
    this.method = "";
    this.weights = null;
  }

  /** Shows the legend of a method. Hides the legend if the method needs none. */
  of(method) {
    if (method === this.method) return;
    this.method = method;
    this.forget();
    this.card.hidden = !["sources", "depth"].includes(method);
    if (method === "sources") this.listCameras();
    if (method === "depth") this.drawScale();
  }

  listCameras() {
    this.caption = element("p", { className: "caption" });
    this.values = this.scene.cameras.map(() => element("output"));
    const rows = this.scene.cameras.map(({ id, color }, k) => {
      const swatch = element("i");
      swatch.style.background = color;
      return element("li", {}, swatch, element("span", { textContent: id }), this.values[k]);
    });
    this.card.replaceChildren(element("h2", { textContent: "Which cameras" }), this.caption, element("ul", {}, ...rows));
    this.list(null, "weight in the whole picture");
  }

  /** Lists the blending weights, one per camera. `weights` is null if they are not known yet. */
  list(weights, caption) {
    this.caption.textContent = caption;
    this.values.forEach((value, k) => {
      value.textContent = weights ? percent(weights[k]) : "";
      value.parentElement.classList.toggle("none", Boolean(weights) && weights[k] < LEAST);
    });
  }

  drawScale() {
    this.caption = element("p", { className: "caption" });
    this.scale = element("div", { className: "scale" });
    this.mark = this.scale.appendChild(element("b", { hidden: true }));
    const colors = this.scene.depth_colors.map((color) => `rgb(${color.join(" ")})`);
    this.scale.style.background = `linear-gradient(to right, ${colors.join(", ")})`;
    this.ends = [element("span"), element("span")];
    this.caption.textContent = UNPOINTED;
    this.card.replaceChildren(element("h2", { textContent: "Depth" }), this.caption, this.scale, element("p", { className: "ends" }, ...this.ends));
  }

  /** Updates the legend after a new picture is shown: the range of its depths, or the cameras' blending weights. */
  async shown(picture, fields) {
    if (this.method === "depth" && picture.depths_m) {
      this.depths_m = picture.depths_m;
      this.ends.forEach((end, k) => (end.textContent = `${["far", "near"][k]}: ${metres(picture.depths_m[k])}`));
    }
    if (this.method !== "sources") return;
    this.forget();
    if (picture.level === "full") await this.load(picture, fields);
  }

  /** Discards the blending weights of the last picture, and cancels the request for them. */
  forget() {
    this.weights = null;
    this.abort?.abort();
    this.abort = new AbortController();
  }

  /** Requests the blending weights of a picture. If the server can't give them, they stay unknown. */
  async load({ width, height }, fields) {
    const { signal } = this.abort;
    const wanted = { ...fields, w: width, h: height, method: "weights", level: "full", slot: "w" };
    const response = await fetch(address("picture", wanted), { signal, cache: "no-store" });
    if (!response.ok) return;
    const bitmap = await createImageBitmap(await response.blob());
    const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
    const context = canvas.getContext("2d", { alpha: false });
    context.drawImage(bitmap, 0, 0);
    const { data } = context.getImageData(0, 0, bitmap.width, bitmap.height);
    if (signal.aborted) return;
    this.weights = { data, width, height };
    this.mean = this.scene.cameras.map((_, k) => this.sum(k) / 255 / width / height);
    this.list(this.mean, "weight in the whole picture");
  }

  at(camera, pixel) {
    const { data, width, height } = this.weights;
    return data[4 * (Math.floor(camera / 3) * width * height + pixel) + (camera % 3)];
  }

  sum(camera) {
    let sum = 0;
    for (let k = 0; k < this.weights.width * this.weights.height; k++) sum += this.at(camera, k);
    return sum;
  }

  /** Shows the weights or the depth at the pointer. `place`: fractions of the picture's size; null if outside of it. */
  point(place, pane) {
    if (this.method === "sources" && this.weights) {
      if (!place) return this.list(this.mean, "weight in the whole picture");
      const { width, height } = this.weights;
      const [x, y] = place.map((v, k) => Math.min([width, height][k] - 1, Math.floor(v * [width, height][k])));
      this.list(this.scene.cameras.map((_, k) => this.at(k, y * width + x) / 255), "weight under the pointer");
    }
    if (this.method === "depth" && this.depths_m) this.pointDepth(place, pane);
    return undefined;
  }

  pointDepth(place, pane) {
    const share = place && this.share(pane.context.getImageData(...pane.pixelAt(place), 1, 1).data);
    const isKnown = typeof share === "number";
    this.mark.hidden = !isKnown;
    this.caption.textContent = UNPOINTED;
    if (!isKnown) return;
    const [far, near] = this.depths_m.map((depth) => 1 / depth);
    this.mark.style.left = `${100 * share}%`;
    this.caption.textContent = `${metres(1 / (far + (near - far) * share))} under the pointer`;
  }

  /** The position of a colour on the depth scale, from 0 (far) to 1 (near); null for a pixel without a depth. */
  share(color) {
    const colors = this.scene.depth_colors;
    let best = { far: 30 ** 2, share: null };
    for (let step = 0; step <= 8 * (colors.length - 1); step++) {
      const [first, part] = [Math.min(Math.floor(step / 8), colors.length - 2), step / 8];
      const far = colors[first].reduce((sum, a, c) => sum + (a + (colors[first + 1][c] - a) * (part - first) - color[c]) ** 2, 0);
      if (far < best.far) best = { far, share: part / (colors.length - 1) };
    }
    return best.share;
  }
}

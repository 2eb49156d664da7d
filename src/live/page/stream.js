// Pictures from the server: while something changes what keeps up, at rest the chosen quality. Each pane has one
// request under way at a time; what nobody waits for any more is cancelled, here and there.

/** How long nothing changes before the chosen quality is asked for, milliseconds. */
const REST_MS = 140;
/** Sizes of quick pictures, as fractions of the full one. */
const SCALES = [1, 0.75, 0.5, 0.35];
/** Beyond this a quick picture takes too long and the next is smaller; below the other, larger. Milliseconds. */
const SLOW_MS = 70;
const FAST_MS = 24;
/** How many quick pictures decide on the size. */
const DECIDING = 4;

const viewer = Array.from(crypto.getRandomValues(new Uint8Array(8)), (b) => b.toString(16).padStart(2, "0")).join("");

/** The address of a picture. */
export function address(name, fields) {
  return `${name}?${new URLSearchParams({ ...fields, viewer })}`;
}

/** The size that fills a window, in pixels: what the cameras resolve, and no more than the screen shows. */
export function fullSize(lens, [width, height]) {
  const cover = Math.min(lens.width / width, lens.height / height);
  const scale = Math.min(cover, window.devicePixelRatio || 1);
  const fit = (length, most) => Math.max(16, Math.min(most, Math.round(length * scale)));
  return [fit(width, lens.width), fit(height, lens.height)];
}

/** Asks for a picture; the sentence of the server if there is none. */
async function load(fields, signal) {
  const start = performance.now();
  const response = await fetch(address("picture", fields), { signal, cache: "no-store" });
  if (!response.ok) {
    const error = new Error((await response.text()).slice(0, 500));
    error.isSuperseded = response.status === 409;
    throw error;
  }
  const bitmap = await createImageBitmap(await response.blob());
  return { bitmap, madeBy: response.headers.get("x-made-by"), took_ms: performance.now() - start };
}

export class Stream {
  /** `show(picture)` and `fail(sentence)` are called for what arrives; `size()` is that of a full picture. */
  constructor(slot, size, show, fail) {
    Object.assign(this, { slot, size, show, fail });
    this.wanted = null;
    this.isFull = false;
    this.abort = null;
    this.scale = 0;
    this.times = [];
  }

  /** What is to be shown from now on: fields of an address, or nothing. */
  want(fields) {
    clearTimeout(this.timer);
    this.wanted = fields;
    this.version = (this.version ?? 0) + 1;
    if (this.abort && (this.isFull || !fields)) {
      this.abort.abort();
      this.abort = null;
    }
    if (fields && !this.abort) this.next("quick");
  }

  /** Asks for a picture of what is wanted now, and after it for the next. */
  async next(level) {
    const { version, slot } = this;
    const [width, height] = this.size();
    const scale = level === "quick" ? SCALES[this.scale] : 1;
    const size = { w: Math.max(16, Math.round(width * scale)), h: Math.max(16, Math.round(height * scale)) };
    const abort = new AbortController();
    this.abort = abort;
    this.isFull = level === "full";
    let problem = null;
    try {
      const picture = await load({ ...this.wanted, ...size, slot, level }, abort.signal);
      if (this.abort !== abort) return;
      if (level === "quick") this.adapt(picture.took_ms);
      this.show({ ...picture, level, width: size.w, height: size.h });
    } catch (error) {
      if (this.abort !== abort || error.name === "AbortError") return;
      problem = error;
      if (!error.isSuperseded) this.fail(error instanceof TypeError ? "The server has ended, or can’t be reached." : error.message);
    }
    this.abort = null;
    if (!this.wanted) return;
    if (version !== this.version) this.next("quick");
    else if ((level === "quick" && !problem) || problem?.isSuperseded) this.timer = setTimeout(() => this.next("full"), REST_MS);
  }

  /** Chooses the size of the next quick pictures. */
  adapt(took_ms) {
    this.times.push(took_ms);
    if (this.times.length < DECIDING) return;
    const middle = this.times.sort((a, b) => a - b)[DECIDING >> 1];
    this.times = [];
    if (middle > SLOW_MS) this.scale = Math.min(this.scale + 1, SCALES.length - 1);
    else if (middle < FAST_MS) this.scale = Math.max(this.scale - 1, 0);
  }
}

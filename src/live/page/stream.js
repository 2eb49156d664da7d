// Pictures from the server: quick ones while something changes, and one of the chosen quality at rest. Each pane has
// one running request at a time. Requests for outdated pictures are cancelled, in the page and in the server.

/** Time without changes after which a picture of the chosen quality is requested, milliseconds. */
const REST_MS = 140;
/** Sizes of quick pictures, as fractions of the size of a full picture. */
const SCALES = [1, 0.75, 0.5, 0.35];
/** Median time from request to picture above which the next quick pictures are smaller, milliseconds. */
const SLOW_MS = 70;
/** Median time from request to picture below which the next quick pictures are larger, milliseconds. */
const FAST_MS = 24;
/** Smallest height of quick pictures, pixels, unless full pictures are smaller. */
const MIN_HEIGHT_PX = 240;
/** Number of quick pictures whose median time decides on the size of the next ones. */
const DECIDING = 4;

const viewer = Array.from(crypto.getRandomValues(new Uint8Array(8)), (b) => b.toString(16).padStart(2, "0")).join("");

/** The address of a picture or of another answer of the server, with the name of this viewer. */
export function address(name, fields) {
  return `${name}?${new URLSearchParams({ ...fields, viewer })}`;
}

/** Size of a full picture, pixels: the size of the lens's image, but at most the size of the picture on the screen. */
export function fullSize(lens, width) {
  const scale = Math.min(1, (width * (window.devicePixelRatio || 1)) / lens.width);
  return [lens.width, lens.height].map((length) => Math.max(16, Math.round(length * scale)));
}

/** Requests and decodes a picture. If the server returns none, throws an error with the server's message. */
async function load(fields, signal) {
  const start = performance.now();
  const response = await fetch(address("picture", fields), { signal, cache: "no-store" });
  if (!response.ok) {
    const error = new Error((await response.text()).slice(0, 500));
    error.isSuperseded = response.status === 409;
    throw error;
  }
  const bitmap = await createImageBitmap(await response.blob());
  const [madeBy, depths] = ["x-made-by", "x-depths"].map((name) => response.headers.get(name));
  return { bitmap, madeBy, depths_m: depths?.split(",").map(Number), took_ms: performance.now() - start };
}

export class Stream {
  /** Calls `show(picture)` or `fail(sentence)` for every answer. `size()` returns the size of a full picture. */
  constructor(slot, size, show, fail) {
    Object.assign(this, { slot, size, show, fail });
    this.wanted = null;
    this.isFull = false;
    this.abort = null;
    this.scale = 0;
    this.times = [];
  }

  /** Sets the wanted picture. `fields` are the fields of its address; null if no picture is wanted. */
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

  /** Requests the wanted picture. After its arrival, requests a newer view, or the same view at full quality. */
  async next(level) {
    const { version, slot } = this;
    const [width, height] = this.size();
    const lowest = Math.min(1, MIN_HEIGHT_PX / height);
    const scale = level === "quick" ? Math.max(lowest, SCALES[this.scale]) : 1;
    const size = { w: Math.max(16, Math.round(width * scale)), h: Math.max(16, Math.round(height * scale)) };
    const abort = new AbortController();
    this.abort = abort;
    this.isFull = level === "full";
    let problem = null;
    try {
      const picture = await load({ ...this.wanted, ...size, slot, level }, abort.signal);
      if (this.abort !== abort) return;
      this.abort = null;
      if (level === "quick") this.adapt(picture.took_ms);
      this.show({ ...picture, level, width: size.w, height: size.h });
    } catch (error) {
      if (this.abort !== abort || error.name === "AbortError") return;
      this.abort = null;
      problem = error;
      if (!error.isSuperseded) this.fail(error instanceof TypeError ? "The server has ended, or can’t be reached." : error.message);
    }
    if (!this.wanted) return;
    if (version !== this.version) this.next("quick");
    else if ((level === "quick" && !problem) || problem?.isSuperseded) this.timer = setTimeout(() => this.next("full"), REST_MS);
  }

  /** Adapts the size of quick pictures to the time that the last ones took. */
  adapt(took_ms) {
    this.times.push(took_ms);
    if (this.times.length < DECIDING) return;
    const middle = this.times.sort((a, b) => a - b)[DECIDING >> 1];
    this.times = [];
    if (middle > SLOW_MS) this.scale = Math.min(this.scale + 1, SCALES.length - 1);
    else if (middle < FAST_MS) this.scale = Math.max(this.scale - 1, 0);
  }
}

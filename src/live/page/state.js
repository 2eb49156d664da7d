// The state of the page: viewpoint, time, zoom and methods, with their bounds, and the link that holds the state.

/** The contents of a picture: names in addresses and links, and names on the page. */
export const METHODS = {
  st: "ST-LFR",
  lfr: "Traditional",
  truth: "Truth",
  sources: "Which cameras",
  depth: "Depth",
};

/** Descriptions of the command line's synchronization and proxy methods, for the page. */
export const WORDS = {
  nearest: "nearest frames",
  crossfade: "cross-faded frames",
  triangulation: "tracked features",
  morph: "morph along edges",
  "edge-morph": "morph, edges boosted",
  refined: "motion per pixel",
  "all-cameras": "motion from all cameras",
  plane: "one plane",
  mesh: "mesh",
  depth: "depth per pixel",
  "scene-flow": "scene flow",
};

/** The name of a ground-truth image: its viewpoint and time. In an id such as t1-between, the time is removed. */
export const truthName = ({ id, time_s: time }) => `${id.replace(/^t\d+-(?=.)/, "")} · ${time.toFixed(4)} s`;

/** Times that differ by less than this, in seconds, count as the same instant. */
const SAME_INSTANT_S = 1e-6;

const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

/** The state of the page. `on` is called after every change, with the names of the changed fields. */
export class State {
  constructor(scene, on) {
    this.scene = scene;
    this.on = on;
    const [first, last] = scene.span_s ?? [0, 0];
    this.home = { x: 0, y: 0, z: 0, yaw: 0, pitch: 0, zoom: 1, at: "" };
    Object.assign(this, this.home, { t: (first + last) / 2, left: "st", right: "", split: 50, sync: "", proxy: "" });
  }

  /** Changes some fields, clamped to their bounds. A new position clears `at`, the name of the viewpoint. */
  set(values) {
    const next = { ...values };
    if (["x", "y", "z"].some((axis) => axis in next) && !("at" in next)) next.at = "";
    const { low, high, zooms, max_turn_deg: turn, span_s: span } = this.scene;
    ["x", "y", "z"].forEach((axis, k) => {
      if (axis in next) next[axis] = clamp(next[axis], low[k], high[k]);
    });
    if ("zoom" in next) next.zoom = clamp(next.zoom, ...zooms);
    for (const axis of ["yaw", "pitch"]) {
      if (axis in next) next[axis] = clamp(next[axis], -turn, turn);
    }
    if ("t" in next) next.t = span ? clamp(next.t, ...span) : 0;
    if ("split" in next) next.split = clamp(next.split, 0, 100);
    this.assign(next);
  }

  /** Changes some fields without clamping, so that the server can report a link's invalid values. */
  assign(next) {
    const changed = Object.keys(next).filter((name) => this[name] !== next[name]);
    Object.assign(this, next);
    if (changed.length) this.on(changed);
  }

  /** Moves to the viewpoint of camera N, `cN`, or to the viewpoint and time of ground-truth image N, `tN`. */
  goTo(at) {
    const index = Number(at.slice(1));
    const place = (at[0] === "t" ? this.scene.truths : this.scene.cameras)[index];
    if (!place) return;
    const [x, y, z] = place.at;
    const time = at[0] === "t" ? { t: place.time_s } : {};
    this.assign({ x, y, z, yaw: 0, pitch: 0, at, ...time });
  }

  /** Whether there is a ground-truth image with the current viewpoint and time. */
  isTrue() {
    const truth = this.at[0] === "t" ? this.scene.truths[Number(this.at.slice(1))] : undefined;
    return Boolean(truth) && Math.abs(truth.time_s - this.t) < SAME_INSTANT_S;
  }

  /** The ground-truth image nearest in space and time, such as `t0`; "" if there is none. */
  nearestTruth() {
    const { truths, spacing_m: spacing } = this.scene;
    const far = ({ at }) => Math.hypot(at[0] - this.x, at[1] - this.y, at[2] - this.z);
    const [first, last] = this.scene.span_s ?? [0, 1];
    // A distance of one camera spacing counts as much as the whole duration of the recording.
    const badness = (truth) => far(truth) / (spacing || 1) + Math.abs(truth.time_s - this.t) / (last - first);
    const best = truths.reduce((a, truth, k) => (a < 0 || badness(truth) < badness(truths[a]) ? k : a), -1);
    return best < 0 ? "" : `t${best}`;
  }

  /** The current time as a fractional frame number of the reference camera. */
  frame() {
    const times = this.scene.frames_s;
    const after = times.findIndex((time) => time > this.t);
    if (after === 0) return 0;
    if (after < 0) return times.length - 1;
    return after - 1 + (this.t - times[after - 1]) / (times[after] - times[after - 1]);
  }

  /** The time of a frame number of the reference camera, seconds. The number may be fractional. */
  timeOf(frame) {
    const times = this.scene.frames_s;
    const k = clamp(Math.floor(frame), 0, times.length - 1);
    const next = Math.min(k + 1, times.length - 1);
    return times[k] + (times[next] - times[k]) * clamp(frame - k, 0, 1);
  }

  /** The fields of a picture's address: viewpoint, zoom, time, and methods that differ from the server's options. */
  query() {
    const place = this.at ? { at: this.at } : { x: this.x.toFixed(6), y: this.y.toFixed(6), z: this.z.toFixed(6) };
    const turn = { yaw: this.yaw.toFixed(3), pitch: this.pitch.toFixed(3) };
    const methods = Object.fromEntries(["sync", "proxy"].filter((name) => this[name]).map((name) => [name, this[name]]));
    return { ...place, ...turn, ...methods, zoom: this.zoom.toFixed(5), t: String(this.t) };
  }

  /** The part of the link after `#`. */
  link() {
    const fields = this.query();
    fields.show = this.left;
    if (this.right) Object.assign(fields, { beside: this.right, split: String(Math.round(this.split * 10) / 10) });
    for (const [name, plain] of [["yaw", 0], ["pitch", 0], ["zoom", 1]]) {
      if (Number(fields[name]) === plain) delete fields[name];
    }
    return new URLSearchParams(fields).toString();
  }

  /**
   * Sets the fields that a link gives. Missing and invalid fields keep their values. But if the link gives a viewpoint,
   * missing rotation and zoom are reset.
   */
  follow(link) {
    const fields = new URLSearchParams(link);
    const at = fields.get("at") ?? "";
    const isNamed = /^[ct]\d{1,6}$/.test(at);
    // A link omits rotation and zoom that have their default values.
    const next = isNamed || ["x", "y", "z"].some((axis) => fields.has(axis)) ? { yaw: 0, pitch: 0, zoom: 1 } : {};
    for (const name of ["x", "y", "z", "yaw", "pitch", "zoom", "t", "split"]) {
      const value = Number(fields.get(name) || NaN);
      if (Number.isFinite(value)) next[name] = value;
    }
    for (const name of ["sync", "proxy"]) {
      const value = fields.get(name);
      if (this.scene.methods[name].some((method) => method.name === value)) next[name] = value === this.scene.chosen[name] ? "" : value;
    }
    const methods = { left: fields.get("show"), right: fields.get("beside") ?? "" };
    if (methods.left in METHODS) {
      next.left = methods.left;
      next.right = methods.right in METHODS ? methods.right : "";
    }
    if (isNamed) {
      this.goTo(at);
      next.at = at;
    } else if (["x", "y", "z"].some((axis) => axis in next)) {
      next.at = "";
    }
    this.assign(next);
  }
}

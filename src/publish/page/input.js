"use strict";

// The visitor's input: it moves the viewpoint, in the rig's axes, and the time.

// Time after an input until the viewpoint sways again, seconds.
const REST_S = 2.5;
// Sway of the viewpoint along each of the rig's axes: amplitude as a fraction of the rig's half extent, and period in
// seconds.
const SWAY = [[0.55, 11], [0.5, 7.3], [0.35, 13.7]];
// Time constant of the viewpoint's exponential approach to its target, seconds.
const EASE_S = 0.12;
// Minimum duration in which the span of time is played, seconds. Shorter spans are played in slow motion.
const MIN_PLAY_S = 5;
// Rotation of the device that moves the viewpoint by half of the rig's extent, degrees.
const TILT_DEG = 18;
// Scroll distance of the wheel that moves the time through the whole span, pixels.
const WHEEL_PX = 1600;

class Motion {
  constructor(rig, scene) {
    this.rig = rig;
    this.span = scene.span;
    this.length = scene.span[1] - scene.span[0];
    this.middle = scaled(sum(rig.low, rig.high), 0.5);
    this.half = scaled(sum(rig.high, scaled(rig.low, -1)), 0.5);
    this.isCalm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.isPlaying = this.length > 0 && !this.isCalm;
    this.time = this.span[0] + 0.5 * this.length;
    this.speed = this.length / Math.max(MIN_PLAY_S, this.length * scene.frame_s);
    this.direction = 1;
    this.target = [...this.middle];
    this.place = [...this.middle];
    this.tilt = [0, 0];
    this.swayed = 0;
    this.swaying = this.isCalm ? 0 : 1;
    this.idle = Infinity;
    this.isStill = false;
  }

  // Sets the given coordinates of the viewpoint, and the time if it is given. Other coordinates are unchanged.
  set({ x, y, z, time }) {
    const given = [x, y, z];
    if (given.some((v) => v !== undefined)) {
      this.target = this.rig.clamped(this.target.map((v, k) => given[k] ?? v));
      this.place = [...this.target];
      this.touch();
    }
    if (time !== undefined) this.time = Math.min(Math.max(time, this.span[0]), this.span[1]);
  }

  touch() { this.idle = 0; }

  shift(by) {
    this.target = this.rig.clamped(sum(this.target, by));
    this.touch();
  }

  // Advances viewpoint and time by `seconds`. Time advances only if `mayPlay` is true, which means that the frames are
  // loaded. Returns whether viewpoint or time changed.
  step(seconds, mayPlay) {
    const before = [...this.place, this.time].join();
    if (this.isPlaying && mayPlay) {
      this.time += this.direction * this.speed * seconds;
      // At an end of the span, time reverses instead of jumping.
      if (this.time > this.span[1]) [this.time, this.direction] = [Math.max(2 * this.span[1] - this.time, this.span[0]), -1];
      if (this.time < this.span[0]) [this.time, this.direction] = [Math.min(2 * this.span[0] - this.time, this.span[1]), 1];
    }
    this.idle += seconds;
    const sways = !this.isCalm && !this.isStill && this.idle > REST_S;
    this.swaying += ((sways ? 1 : 0) - this.swaying) * Math.min(1, seconds / (sways ? 1.5 : EASE_S));
    if (this.swaying < 1e-3) this.swaying = 0;
    this.swayed += seconds * this.swaying;
    const sway = SWAY.map(([size, period], k) => size * this.half[k] * this.swaying * Math.sin((2 * Math.PI * this.swayed) / period));
    const tilted = [this.tilt[0] * this.half[0], this.tilt[1] * this.half[1], 0];
    // While the viewpoint sways, its target returns to the rig's middle.
    if (sways) this.target = sum(this.target, scaled(sum(this.middle, scaled(this.target, -1)), Math.min(1, seconds / 6)));
    const goal = this.rig.clamped(sum(sum(this.target, sway), tilted));
    const share = 1 - Math.exp(-seconds / EASE_S);
    this.place = this.place.map((v, k) => {
      const next = v + (goal[k] - v) * share;
      return Math.abs(goal[k] - next) < 1e-4 * Math.max(this.half[k], 1e-9) ? goal[k] : next;
    });
    return before !== [...this.place, this.time].join();
  }
}

// Moves the viewpoint and time of `motion` by the element's events. Calls `changed` after each event.
function listen(element, motion, changed) {
  const pointers = new Map();
  const spread = () => {
    const [p, q] = [...pointers.values()];
    return q ? Math.hypot(p[0] - q[0], p[1] - q[1]) : 0;
  };
  element.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    element.setPointerCapture(event.pointerId);
  });
  element.addEventListener("pointermove", (event) => {
    const from = pointers.get(event.pointerId);
    if (!from) return;
    const before = spread();
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    const side = Math.min(element.clientWidth, 1.3 * element.clientHeight);
    const [x, y] = [event.clientX - from[0], event.clientY - from[1]].map((v) => v / side / pointers.size);
    const closer = pointers.size > 1 ? (spread() - before) / side : 0;
    // The scene follows the pointer: if the pointer moves to the right, the viewpoint moves to the left.
    const by = [-2 * x, 2 * y, 2 * closer];
    motion.shift(by.map((v, k) => 1.4 * v * Math.max(motion.half[k], 0.35 * Math.max(...motion.half))));
    changed();
  });
  for (const name of ["pointerup", "pointercancel"]) element.addEventListener(name, (event) => pointers.delete(event.pointerId));
  element.addEventListener("click", askForTilt);
  element.addEventListener("wheel", (event) => {
    const lines = event.deltaMode === 1 ? 16 : 1;
    if (Math.abs(event.deltaX) > Math.abs(event.deltaY) || event.shiftKey) {
      motion.shift([(event.deltaX || event.deltaY) * lines * motion.half[0] / 400, 0, 0]);
    } else {
      const time = motion.time + (event.deltaY * lines * motion.length) / WHEEL_PX;
      // Beyond the ends of the span, the event isn't consumed, so that a page that embeds this page scrolls.
      if (time < motion.span[0] || time > motion.span[1]) {
        motion.set({ time });
        changed();
        return;
      }
      motion.isPlaying = false;
      motion.set({ time });
    }
    event.preventDefault();
    changed();
  }, { passive: false });
  element.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: [-0.1, 0, 0], ArrowRight: [0.1, 0, 0], ArrowUp: [0, 0.2, 0], ArrowDown: [0, -0.2, 0], w: [0, 0, 0.2], s: [0, 0, -0.2] };
    const by = steps[event.key];
    if (by) motion.shift(by.map((v, k) => v * motion.half[k]));
    else if (event.key === " ") motion.isPlaying = !motion.isPlaying && motion.length > 0;
    else if (event.key === "," || event.key === ".") {
      motion.isPlaying = false;
      motion.set({ time: motion.time + (event.key === "," ? -0.1 : 0.1) });
    } else return;
    event.preventDefault();
    changed();
  });
  followTilt(motion, changed);
}

let hasAskedForTilt = false;

// Requests access to the device's orientation, in browsers that have such a request. Some of them ask the visitor, and
// only after a touch. Others grant access without asking.
function askForTilt() {
  if (hasAskedForTilt || typeof DeviceOrientationEvent === "undefined" || !DeviceOrientationEvent.requestPermission) return;
  hasAskedForTilt = true;
  DeviceOrientationEvent.requestPermission().catch(() => {});
}

// Moves the viewpoint by the device's rotation away from a reference orientation. The reference orientation slowly
// follows the device's orientation.
function followTilt(motion, changed) {
  let held = null;
  addEventListener("deviceorientation", ({ beta, gamma }) => {
    if (beta === null || gamma === null) return;
    const angle = screen.orientation?.angle ?? 0;
    const turns = { 0: [gamma, beta], 90: [beta, -gamma], 180: [-gamma, -beta], 270: [-beta, gamma] };
    const turn = turns[angle] ?? turns[0];
    held ??= turn;
    held = held.map((v, k) => v + (turn[k] - v) * 0.01);
    const tilt = turn.map((v, k) => Math.min(Math.max((v - held[k]) / TILT_DEG, -1), 1));
    if (Math.hypot(tilt[0] - motion.tilt[0], tilt[1] - motion.tilt[1]) < 0.01) return;
    if (Math.hypot(...tilt) > 0.1) motion.touch();
    motion.tilt = [tilt[0], -tilt[1]];
    changed();
  });
}

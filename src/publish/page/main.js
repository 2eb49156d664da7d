"use strict";

// Quality levels of views while something moves, best first: number of cameras, whether two frames of a camera are
// blended around their middle, whether a cell of blocks is drawn as one point, scale of the picture, and whether images are
// sampled by cubic interpolation. `anyTrust` allows confidences that were computed together with other frames.
const LEVELS = [
  { cameras: 8, fades: true, hasCells: false, scale: 1, isCubic: true },
  { cameras: 8, fades: true, hasCells: true, scale: 1, isCubic: true },
  { cameras: 6, fades: true, hasCells: true, scale: 1, isCubic: false },
  { cameras: 4, fades: false, hasCells: true, scale: 0.75, isCubic: false },
  { cameras: 4, fades: false, hasCells: true, scale: 0.5, isCubic: false },
  { cameras: 3, fades: false, hasCells: true, scale: 0.4, isCubic: false },
].map((level) => ({ ...level, anyTrust: true }));
const AT_REST = { cameras: 8, fades: true, hasCells: false, scale: 1, isCubic: true, anyTrust: false };
// Index of the quality level of the very first picture, and of the pictures after it.
const FIRST_PICTURE_LEVEL = 4;
const FIRST_LEVEL = 2;
// Thresholds of the interval between pictures, milliseconds. Above SLOW_MS, the next lower quality level is used. Below
// FAST_MS for PATIENCE pictures, the next better level is used.
const SLOW_MS = 38;
const FAST_MS = 20;
// Number of pictures that must be fast before a better quality level is tried. It is multiplied by 4 each time that a
// level turns out to be too slow, up to MAX_PATIENCE.
const PATIENCE = 24;
const MAX_PATIENCE = 2000;
// Number of intervals between pictures whose median chooses the quality level. On slow graphics cards, fewer intervals
// suffice if they last JUDGED_MS milliseconds together.
const JUDGED = 8;
const JUDGED_MS = 500;
// Maximum focal length of a picture, as a multiple of the frames' focal length. A larger picture would have no more
// detail.
const MAX_ENLARGEMENT = 2;
// Maximum number of canvas pixels per CSS pixel, in each direction.
const MAX_PIXEL_RATIO = 2;

const byId = (id) => document.getElementById(id);

stlfr.scene = (scene) => {
  const problem = (error) => {
    byId("problem").textContent = error.message ?? String(error);
    byId("problem").hidden = false;
    byId("loading").classList.add("done");
  };
  try {
    if (typeof DecompressionStream === "undefined") throw new Error("This page needs a newer browser.");
    new Viewer(scene, problem).start();
  } catch (error) {
    problem(error);
  }
};

class Viewer {
  constructor(scene, problem) {
    this.scene = scene;
    this.problem = problem;
    scene.cameras = scene.cameras.map((c) => ({ ...c, ...cameraFromPose(c.size, c.lens, c.pose) }));
    this.canvas = byId("view");
    this.renderer = new Renderer(this.canvas, scene, (failure) => this.arrived(failure));
    this.rig = new Rig(scene);
    this.motion = new Motion(this.rig, scene);
    this.level = FIRST_LEVEL;
    this.patience = PATIENCE;
    this.fast = 0;
    this.intervals = [];
    this.isDirty = true;
    this.isShown = false;
    this.statistics = { pictures: 0, firstMs: null, level: this.level };
  }

  start() {
    const { motion, canvas, scene } = this;
    document.title = scene.name;
    document.documentElement.classList.toggle("framed", window.parent !== window);
    document.documentElement.classList.toggle("still", motion.length === 0);
    listen(canvas, motion, () => { this.isDirty = true; });
    new ResizeObserver(() => { this.isDirty = true; }).observe(canvas);
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => location.reload());
    byId("play").addEventListener("click", () => { motion.isPlaying = !motion.isPlaying; });
    byId("time").addEventListener("input", (event) => {
      motion.isPlaying = false;
      motion.set({ time: motion.span[0] + (event.target.value / 1000) * motion.length });
    });
    this.follow(location.hash);
    addEventListener("hashchange", () => this.follow(location.hash));
    byId("bar").hidden = false;
    this.offer();
    requestAnimationFrame((now) => this.frame(now));
  }

  // Offers functions and values to other scripts on the page, and to tests.
  offer() {
    // Returns a canvas with the view of a `view.json` (as for `stlfr render --camera`) at an instant in seconds.
    stlfr.picture = async (view, seconds) => {
      const target = viewOf(view);
      const time = (seconds - this.scene.origin_s) / (this.scene.frame_s || 1);
      const sources = this.renderer.frames.of(target.center, time, AT_REST);
      this.asked = sources.map((s) => s.frame);
      while (this.asked.some((f) => f.layer < 0)) {
        if (this.renderer.frames.failure) throw this.renderer.frames.failure;
        this.renderer.frames.want(this.asked, time, true);
        await new Promise((resolve) => setTimeout(resolve, 5));
      }
      this.renderer.draw(target, time, sources, AT_REST);
      this.asked = null;
      this.isDirty = true;
      return this.renderer.picture();
    };
    stlfr.statistics = this.statistics;
    stlfr.motion = this.motion;
  }

  // Moves to the viewpoint and time in the address's fragment, such as #t=0.1&x=0.02, and stops time.
  follow(hash) {
    const given = new URLSearchParams(hash.slice(1));
    const number = (name) => {
      const value = Number.parseFloat(given.get(name));
      return Number.isFinite(value) ? value : undefined;
    };
    const [x, y, z, t] = ["x", "y", "z", "t"].map(number);
    if ([x, y, z, t].every((v) => v === undefined)) return;
    this.motion.isPlaying = false;
    this.motion.isStill = true;
    const time = t === undefined ? undefined : (t - this.scene.origin_s) / (this.scene.frame_s || 1);
    this.motion.set({ x, y, z, time });
    this.isDirty = true;
  }

  arrived(failure) {
    if (failure) this.problem(failure);
    const fraction = Math.min(1, this.renderer.frames.fraction);
    byId("loading").style.transform = `scaleX(${fraction})`;
    byId("loading").classList.toggle("done", fraction >= 1);
    this.isDirty = true;
  }

  get pixelSize() {
    const ratio = Math.min(devicePixelRatio, MAX_PIXEL_RATIO);
    return [this.canvas.clientWidth, this.canvas.clientHeight].map((v) => Math.max(1, Math.round(v * ratio)));
  }

  frame(now) {
    requestAnimationFrame((next) => this.frame(next));
    const interval = now - (this.before ?? now);
    const elapsed = Math.min(interval, 250);
    this.before = now;
    const { motion, renderer } = this;
    const moved = motion.step(elapsed / 1000, this.isShown && this.isReady);
    if (moved) this.moved = now;
    this.update();
    const isResting = now - (this.moved ?? 0) > 200;
    if (this.drewMoving && moved) this.adapt(interval);
    this.drewMoving = false;
    if (this.asked || !(moved || this.isDirty || (isResting && !this.isExact))) return;
    // The first picture has few frames and pixels, so that it appears soon.
    const moving = LEVELS[this.isShown ? this.level : FIRST_PICTURE_LEVEL];
    const quality = isResting && this.isShown ? AT_REST : moving;
    const size = this.pixelSize;
    const whole = this.rig.view(motion.place, size);
    const scale = quality.scale * Math.min(1, MAX_ENLARGEMENT / whole.scale);
    const view = this.rig.view(motion.place, size.map((v) => Math.max(1, Math.round(v * scale))));
    const sources = renderer.frames.of(view.center, motion.time, quality);
    renderer.frames.want(sources.map((s) => s.frame), motion.time, this.isShown);
    const ready = sources.filter((s) => s.frame.layer >= 0);
    this.isReady = ready.length === sources.length;
    this.isDirty = false;
    // The first picture is drawn when all its frames are loaded. Later pictures are drawn from the frames that are
    // loaded.
    if (!this.isReady && (!this.isShown || ready.length === 0)) return;
    try {
      if (this.canvas.width !== size[0] || this.canvas.height !== size[1]) [this.canvas.width, this.canvas.height] = size;
      renderer.draw(view, motion.time, ready, quality);
      renderer.show(whole.size);
    } catch (error) {
      this.problem(error);
      return;
    }
    this.isExact = quality === AT_REST && this.isReady;
    // After the first picture, another call requests the other frames.
    this.isDirty = !this.isReady || !this.isShown;
    this.drewMoving = !isResting;
    this.statistics.pictures += 1;
    this.statistics.firstMs ??= performance.now();
    this.isShown = true;
  }

  // Chooses the quality level by the median interval between the last pictures.
  adapt(milliseconds) {
    const { intervals } = this;
    intervals.push(milliseconds);
    const total = intervals.reduce((all, v) => all + v, 0);
    if (intervals.length < JUDGED && (total < JUDGED_MS || intervals.length < 2)) return;
    const median = [...intervals].sort((p, q) => p - q)[Math.floor(intervals.length / 2)];
    intervals.length = 0;
    this.fast = median < FAST_MS ? this.fast + JUDGED : 0;
    if (median > SLOW_MS && this.level < LEVELS.length - 1) {
      this.level += 1;
      // While frames are loaded, pictures also wait for the decoding of frames, which says nothing about this level.
      if (this.renderer.frames.fraction >= 1) this.patience = Math.min(4 * this.patience, MAX_PATIENCE);
    } else if (this.fast >= this.patience && this.level > 0) {
      this.level -= 1;
      this.fast = 0;
    }
    this.statistics.level = this.level;
  }

  // Shows the state in the bar: the play button, the time slider and the clock.
  update() {
    const { motion, scene } = this;
    const seconds = scene.origin_s + scene.frame_s * motion.time;
    byId("play").setAttribute("aria-pressed", String(motion.isPlaying));
    const label = motion.isPlaying ? "Stop time" : "Play";
    byId("play").setAttribute("aria-label", label);
    byId("play").title = `${label} (space)`;
    if (motion.length > 0) byId("time").value = (1000 * (motion.time - motion.span[0])) / motion.length;
    byId("time").setAttribute("aria-valuetext", `${seconds.toFixed(3)} seconds`);
    byId("clock").textContent = motion.length > 0 ? `${seconds.toFixed(3)} s` : "";
  }
}

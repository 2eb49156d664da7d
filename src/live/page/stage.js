// The pictures that fill the window, and the gestures on them.

/** Duration of the cross-fade from a quick picture to one of full quality, milliseconds. */
const FADE_MS = 280;

/** A pane shows the pictures of one method, or the reason why there is none. Each new picture dispatches an event. */
export class Pane {
  constructor(element) {
    this.element = element;
    [this.canvas, this.before] = element.querySelectorAll("canvas");
    this.context = this.canvas.getContext("2d", { alpha: false });
    this.problem = element.querySelector(".problem");
    this.button = this.problem.querySelector("button");
    this.picture = null;
  }

  /** Shows a picture. After a quick picture, a picture of full quality is faded in. */
  show(picture) {
    const { bitmap } = picture;
    this.before.hidden = true;
    if (picture.level === "full" && this.picture?.level === "quick") this.fade();
    if (this.canvas.width !== bitmap.width || this.canvas.height !== bitmap.height) {
      this.canvas.width = bitmap.width;
      this.canvas.height = bitmap.height;
      this.canvas.hidden = false;
    }
    this.context.drawImage(bitmap, 0, 0);
    bitmap.close();
    this.picture = picture;
    this.fail("");
    this.element.dispatchEvent(new CustomEvent("picture", { detail: picture.level }));
  }

  /** Starts a cross-fade: lays a copy of the last picture over the next picture, and fades the copy out. */
  fade() {
    const { before, canvas } = this;
    [before.width, before.height] = [canvas.width, canvas.height];
    before.getContext("2d", { alpha: false }).drawImage(canvas, 0, 0);
    before.hidden = false;
    const isSteady = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const fade = before.animate({ opacity: [1, 0] }, { duration: isSteady ? 0 : FADE_MS, easing: "ease-out" });
    fade.onfinish = () => (before.hidden = true);
  }

  /** The pixel of the picture at fractions of its width and height. */
  pixelAt([x, y]) {
    const { width, height } = this.canvas;
    return [x * width, y * height].map((v, k) => Math.min([width, height][k] - 1, Math.max(0, Math.floor(v))));
  }

  /** Centres the pane's message horizontally in the pane's visible part, at `percent` of the picture's width. */
  center(percent) {
    this.problem.style.left = `${percent}%`;
    this.problem.style.maxWidth = `min(30rem, ${2 * Math.min(percent, 100 - percent)}% - 32px)`;
  }

  /** Shows why there is no picture, over the greyed last picture. `action` is a button's label and its function. */
  fail(sentence, action) {
    this.problem.hidden = !sentence;
    this.problem.firstElementChild.textContent = sentence && sentence[0].toUpperCase() + sentence.slice(1) + (/[.!?…]$/.test(sentence) ? "" : ".");
    this.element.classList.toggle("stale", Boolean(sentence));
    this.button.hidden = !action;
    if (action) [this.button.textContent, this.button.onclick] = action;
  }
}

/** Change of the natural logarithm of the zoom per pixel that the wheel scrolls. */
const WHEEL = 0.0015;
/** Rotation of the view by a drag over the picture's width, degrees at zoom 1. */
const DRAG_TURN_DEG = 40;

/** Makes drags, pinches and the wheel on an element change the viewpoint, the rotation and the zoom. */
export function gestures(element, picture, state) {
  const pointers = new Map();
  const range = () => {
    const { low, high } = state.scene;
    return Math.max(...low.map((v, k) => high[k] - v));
  };
  const metres = (px) => (px / Math.max(1, picture.clientWidth)) * range();

  element.addEventListener("pointerdown", (event) => {
    if (event.target.closest("button, input") || event.button > 2) return;
    element.setPointerCapture(event.pointerId);
    // While this mark is set, the focused element has no outline. The next key press removes the mark.
    element.dataset.focusedBy = "pointer";
    element.focus({ preventScroll: true });
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY, turns: event.button === 2 });
  });
  element.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const [dx, dy] = [event.clientX - before.x, event.clientY - before.y];
    if (pointers.size > 1) {
      const [a, b] = [...pointers.values()];
      const apart = Math.hypot(a.x - b.x, a.y - b.y);
      Object.assign(before, { x: event.clientX, y: event.clientY });
      if (apart > 0) state.set({ zoom: (state.zoom * Math.hypot(a.x - b.x, a.y - b.y)) / apart });
      return;
    }
    Object.assign(before, { x: event.clientX, y: event.clientY });
    if (event.shiftKey) state.set({ x: state.x - metres(dx), z: state.z - metres(dy) });
    else if (event.ctrlKey || event.metaKey || before.turns) {
      const turn = DRAG_TURN_DEG / Math.max(1, picture.clientWidth) / state.zoom;
      state.set({ yaw: state.yaw - dx * turn, pitch: state.pitch + dy * turn });
    } else state.set({ x: state.x - metres(dx), y: state.y + metres(dy) });
  });
  for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
    element.addEventListener(end, (event) => pointers.delete(event.pointerId));
  }
  document.addEventListener("keydown", () => delete element.dataset.focusedBy);
  element.addEventListener("contextmenu", (event) => event.preventDefault());
  element.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 30 : 1;
      state.set({ zoom: state.zoom * Math.exp(-WHEEL * lines * event.deltaY) });
    },
    { passive: false },
  );
}

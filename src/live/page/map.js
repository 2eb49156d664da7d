// The rig and the viewpoint, seen from behind the cameras: a small map, on which the viewpoint can be dragged.

const SVG = "http://www.w3.org/2000/svg";
/** Distance within which a tap selects a camera, pixels. */
const SNAP_PX = 9;

/** Creates an SVG element, and appends it to `parent`. */
export function shape(name, parent, attributes) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  parent.append(element);
  return element;
}

export class RigMap {
  constructor(svg, state) {
    Object.assign(this, { svg, state });
    const { low, high } = state.scene;
    this.low = low;
    this.size = [high[0] - low[0], high[1] - low[1]];
    this.drawn = "";
    this.dots = [];
    svg.addEventListener("pointerdown", (event) => {
      svg.setPointerCapture(event.pointerId);
      this.down = [event.clientX, event.clientY];
      if (!this.snap(event)) this.move(event);
    });
    svg.addEventListener("pointermove", (event) => {
      if (!this.down || !svg.hasPointerCapture(event.pointerId)) return;
      const far = Math.hypot(event.clientX - this.down[0], event.clientY - this.down[1]);
      if (far > 3 || this.isMoving) {
        this.isMoving = true;
        this.move(event);
      }
    });
    for (const end of ["pointerup", "pointercancel"]) {
      svg.addEventListener(end, () => Object.assign(this, { down: null, isMoving: false }));
    }
    new ResizeObserver(() => this.draw()).observe(svg);
  }

  /** The map's size and scale, and the conversions between positions (metres) and pixels. */
  frame() {
    const [width, height] = [this.svg.clientWidth || 1, this.svg.clientHeight || 1];
    const scale = Math.min(width / this.size[0], height / this.size[1]);
    const [dx, dy] = [(width - scale * this.size[0]) / 2, (height - scale * this.size[1]) / 2];
    return {
      width,
      height,
      scale,
      px: ([x, y]) => [dx + scale * (x - this.low[0]), height - dy - scale * (y - this.low[1])],
      place: (px, py) => [this.low[0] + (px - dx) / scale, this.low[1] + (height - dy - py) / scale],
    };
  }

  local(event) {
    const box = this.svg.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  move(event) {
    const [x, y] = this.frame().place(...this.local(event));
    this.state.set({ x, y });
  }

  /** Moves the viewpoint to the camera under the pointer. Returns false if no camera is there. */
  snap(event) {
    const [px, py] = this.local(event);
    const { px: pixels } = this.frame();
    const far = ({ at }) => Math.hypot(pixels(at)[0] - px, pixels(at)[1] - py);
    const { cameras } = this.state.scene;
    const nearest = cameras.reduce((a, camera, k) => (far(camera) < far(cameras[a]) ? k : a), 0);
    if (far(cameras[nearest]) > SNAP_PX) return false;
    this.state.goTo(`c${nearest}`);
    return true;
  }

  /** Draws the whole map if its size has changed. Then moves the mark of the viewpoint. */
  draw() {
    const { scene } = this.state;
    const frame = this.frame();
    const key = `${frame.width} ${frame.height}`;
    if (this.drawn !== key) {
      this.drawn = key;
      this.svg.replaceChildren();
      const [x0, y1] = frame.px(this.low);
      const [width, height] = this.size.map((v) => v * frame.scale);
      shape("rect", this.svg, { class: "bounds", x: x0, y: y1 - height, width, height, rx: 6 });
      const name = (at) => frame.px(at).map((v) => v.toFixed(0)).join();
      const seen = new Set(scene.cameras.map(({ at }) => name(at)));
      for (const { at } of scene.truths) {
        if (seen.has(name(at))) continue;
        seen.add(name(at));
        const [x, y] = frame.px(at);
        shape("rect", this.svg, { class: "truth", x: x - 4, y: y - 4, width: 8, height: 8, transform: `rotate(45 ${x} ${y})` });
      }
      this.dots = scene.cameras.map(({ at, id }) => {
        const [cx, cy] = frame.px(at);
        const dot = shape("circle", this.svg, { class: "camera", cx, cy, r: 3.5 });
        shape("title", dot, {}).textContent = id;
        return dot;
      });
      this.view = shape("circle", this.svg, { class: "view", r: 6, "stroke-width": 2 });
    }
    const [x, y] = frame.px([this.state.x, this.state.y]);
    this.view.setAttribute("cx", x);
    this.view.setAttribute("cy", y);
    const hasColors = [this.state.left, this.state.right].includes("sources");
    this.dots.forEach((dot, k) => {
      dot.style.fill = hasColors ? scene.cameras[k].color : "";
      dot.setAttribute("r", hasColors ? 5 : 3.5);
    });
  }
}

// The rig from above: the cameras' fields of view, and that of the viewpoint, which can be dragged.

import { shape } from "./map.js";

/** Margin around the map, pixels. It is needed because fields of view extend beyond the bounds of viewpoints. */
const MARGIN_PX = 4;
/** Drawn length of a field of view, as a fraction of the width of the bounds of viewpoints. */
const REACH = 0.2;

export class Plan {
  constructor(svg, state) {
    Object.assign(this, { svg, state });
    const move = (event) => {
      const box = svg.getBoundingClientRect();
      const { place } = this.frame();
      const [x, z] = place(event.clientX - box.left, event.clientY - box.top);
      state.set({ x, z });
    };
    svg.addEventListener("pointerdown", (event) => {
      svg.setPointerCapture(event.pointerId);
      move(event);
    });
    svg.addEventListener("pointermove", (event) => svg.hasPointerCapture(event.pointerId) && move(event));
    new ResizeObserver(() => this.draw()).observe(svg);
  }

  /** The conversions between positions (metres to the right and ahead) and pixels of the map. */
  frame() {
    const [width, height] = [this.svg.clientWidth || 1, this.svg.clientHeight || 1];
    const { low, high } = this.state.scene;
    const reach = REACH * (high[0] - low[0]);
    const [across, ahead] = [high[0] - low[0], high[2] - low[2] + reach];
    const scale = Math.min((width - 2 * MARGIN_PX) / across, (height - 2 * MARGIN_PX) / ahead);
    const [dx, dy] = [(width - scale * across) / 2, (height - scale * ahead) / 2];
    return {
      reach,
      px: (x, z) => [dx + scale * (x - low[0]), height - dy - scale * (z - low[2])],
      place: (px, py) => [low[0] + (px - dx) / scale, low[2] + (height - dy - py) / scale],
    };
  }

  /** The direction of a view, radians to the right: the mean of the cameras' directions, weighted as in the server. */
  direction({ x, y, z }) {
    const { cameras, spacing_m: spacing } = this.state.scene;
    const soft = Math.max(0.5 * spacing, 1e-9);
    const sum = [0, 0];
    for (const { at, ahead } of cameras) {
      const weight = 1 / (((at[0] - x) ** 2 + (at[1] - y) ** 2 + (at[2] - z) ** 2) / soft ** 2 + 1);
      sum[0] += weight * ahead[0];
      sum[1] += weight * ahead[2];
    }
    return Math.atan2(sum[0], sum[1]);
  }

  /** The outline of a field of view on the map, as the points of an SVG polygon: its apex and its two far corners. */
  field(x, z, angle, zoom) {
    const { px, reach } = this.frame();
    const half = Math.atan(0.5 / (this.state.scene.lens.focal * zoom));
    const corner = (side) => px(x + reach * Math.sin(angle + side), z + reach * Math.cos(angle + side));
    return [px(x, z), corner(-half), corner(half)].map((point) => point.map((v) => v.toFixed(1)).join()).join(" ");
  }

  draw() {
    // A hidden map has no size, and can't be drawn.
    if (!this.svg.clientWidth) return;
    const { scene, ...now } = this.state;
    const hasColors = [now.left, now.right].includes("sources");
    const fields = scene.cameras.map(({ at, ahead, color }) => {
      const points = this.field(at[0], at[2], Math.atan2(ahead[0], ahead[2]), 1);
      const made = shape("polygon", this.svg, { class: "field", points });
      if (hasColors) made.style.fill = made.style.stroke = color;
      return made;
    });
    const angle = this.direction(now) + (now.yaw * Math.PI) / 180;
    const view = shape("polygon", this.svg, { class: "field own", points: this.field(now.x, now.z, angle, now.zoom) });
    const [cx, cy] = this.frame().px(now.x, now.z);
    const { low, high } = scene;
    const [[left, top], [right, bottom]] = [this.frame().px(low[0], high[2]), this.frame().px(high[0], low[2])];
    const bounds = shape("rect", this.svg, { class: "bounds", x: left, y: top, width: right - left, height: bottom - top, rx: 6 });
    this.svg.replaceChildren(bounds, ...fields, view, shape("circle", this.svg, { class: "view", r: 5, "stroke-width": 2, cx, cy }));
  }
}

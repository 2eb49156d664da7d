"use strict";

// Vectors are arrays of three numbers. 3×3 matrices are arrays of nine numbers, row by row.

const sum = (p, q) => p.map((v, k) => v + q[k]);
const scaled = (p, s) => p.map((v) => v * s);
const dot = (p, q) => p.reduce((total, v, k) => total + v * q[k], 0);
const cross = (p, q) => [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]];
const unit = (p) => scaled(p, 1 / Math.hypot(...p));
const row = (m, k) => m.slice(3 * k, 3 * k + 3);
const transposed = (m) => [0, 3, 6, 1, 4, 7, 2, 5, 8].map((k) => m[k]);
const product = (m, n) => m.map((_, k) => dot(row(m, Math.floor(k / 3)), [n[k % 3], n[3 + (k % 3)], n[6 + (k % 3)]]));
const transform = (m, p) => [0, 1, 2].map((k) => dot(row(m, k), p));
const lensMatrix = ([fx, fy, cx, cy]) => [fx, 0, cx, 0, fy, cy, 0, 0, 1];
const inverseLens = ([fx, fy, cx, cy]) => [1 / fx, 0, -cx / fx, 0, 1 / fy, -cy / fy, 0, 0, 1];

// Creates a camera: image size, lens, rotation and translation from the world to the camera, and centre in the world.
function camera(size, lens, rotation, translation) {
  return { size, lens, rotation, translation, center: scaled(transform(transposed(rotation), translation), -1) };
}

function cameraFromPose(size, lens, pose) {
  const at = (k) => pose[4 * Math.floor(k / 3) + (k % 3)];
  return camera(size, lens, Array.from({ length: 9 }, (_, k) => at(k)), [3, 7, 11].map((k) => pose[k]));
}

// Returns the projection from one camera to another: h = A (x, y, 1) + q b. Here, (x, y) is a pixel and q an inverse
// depth of the camera `from`, and h is the homogeneous pixel of the camera `to`. A is column by column, as WebGL takes
// it.
function projection(from, to) {
  const rotation = product(to.rotation, transposed(from.rotation));
  const translation = sum(to.translation, scaled(transform(rotation, from.translation), -1));
  const lens = lensMatrix(to.lens);
  return { a: transposed(product(product(lens, rotation), inverseLens(from.lens))), b: transform(lens, translation) };
}

// Maximum factor by which a picture is enlarged, and cropped, to fill the page. 1 is the size at which all of it fits.
const MAX_CROP = 1.6;
// Enlargement of views, so that the frames' borders stay outside of views from beside the cameras.
const ZOOM = 1.05;
// Distance from the viewpoint at which a camera's direction has half its weight, in units of the distance between
// neighbouring cameras.
const SOFT_SPACINGS = 0.5;
// Minimum half extent of the range of viewpoints along each of the rig's axes, in units of the distance between
// neighbouring cameras.
const MARGIN_SPACINGS = 0.4;

// The camera rig, with its own axes: x to the right, y up, z ahead, metres from the mean of the cameras' centres.
class Rig {
  constructor(scene) {
    this.cameras = scene.cameras;
    this.spacing = scene.spacing_m;
    this.reference = scene.cameras.find((c) => c.camera === scene.reference) ?? scene.cameras[0];
    this.axes = this.looking(() => 1);
    this.middle = scaled(scene.cameras.map((c) => c.center).reduce(sum), 1 / scene.cameras.length);
    const places = scene.cameras.map((c) => this.place(c.center));
    this.low = [0, 1, 2].map((k) => Math.min(...places.map((p) => p[k])));
    this.high = [0, 1, 2].map((k) => Math.max(...places.map((p) => p[k])));
    const margin = MARGIN_SPACINGS * this.spacing;
    for (let k = 0; k < 3; k++) {
      const missing = Math.max(0, margin - (this.high[k] - this.low[k]) / 2);
      this.low[k] -= missing;
      this.high[k] += missing;
    }
  }

  // Returns the rotation from the world to a view in the cameras' mean direction. `weight` returns a camera's weight.
  looking(weight) {
    const directions = [2, 1].map((k) => this.cameras.map((c) => scaled(row(c.rotation, k), weight(c))).reduce(sum));
    const ahead = unit(directions[0]);
    const right = unit(cross(directions[1], ahead));
    const axes = [...right, ...cross(ahead, right), ...ahead];
    return axes.every(Number.isFinite) ? axes : this.reference.rotation;
  }

  place(point) {
    const [x, y, z] = transform(this.axes, sum(point, scaled(this.middle, -1)));
    return [x, -y, z];
  }

  clamped(place) { return place.map((v, k) => Math.min(Math.max(v, this.low[k]), this.high[k])); }

  // Returns the view from a viewpoint in the rig's axes, in the mean direction of the cameras nearby. Its size is
  // `page`, pixels, or smaller if the view would otherwise be cropped more than MAX_CROP allows.
  view([x, y, z], page) {
    const center = sum(this.middle, transform(transposed(this.axes), [x, -y, z]));
    const soft = Math.max(SOFT_SPACINGS * this.spacing, 1e-9);
    const rotation = this.looking((c) => 1 / (Math.hypot(...sum(c.center, scaled(center, -1))) ** 2 / soft ** 2 + 1));
    const [w, h] = this.reference.size;
    const [fit, fill] = [Math.min, Math.max].map((of) => of(page[0] / w, page[1] / h));
    const scale = ZOOM * Math.min(fill, MAX_CROP * fit);
    const size = [w, h].map((v, k) => Math.max(1, Math.min(page[k], Math.round((scale / ZOOM) * v))));
    const [fx, fy, cx, cy] = this.reference.lens;
    const lens = [scale * fx, scale * fy, size[0] / 2 + scale * (cx - w / 2), size[1] / 2 + scale * (cy - h / 2)];
    const view = camera(size, lens, rotation, scaled(transform(rotation, center), -1));
    return { ...view, scale };
  }
}

// Converts a view in the form of a `view.json`, as for `stlfr render --camera`, to a camera.
function viewOf({ width, height, model, params, cam_from_world: { rotation_wxyz: q, translation } }) {
  if (model !== "PINHOLE") throw new Error("model: must be PINHOLE");
  const [w, x, y, z] = scaled(q, 1 / Math.hypot(...q));
  const rotation = [
    1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
    2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
    2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
  ];
  return camera([width, height], params, rotation, translation);
}

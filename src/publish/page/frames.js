"use strict";

// The page's global object. The scripts `scene.js` and `frames/*.js` call its functions to hand over their data.
const stlfr = {};
window.stlfr = stlfr;

// Maximum memory of the graphics card for decoded frames, bytes. It is smaller on devices with a touch screen, such as
// phones.
const MAX_FRAME_BYTES = matchMedia("(pointer: coarse)").matches ? 160e6 : 400e6;
const CHANNELS = 6;
// Maximum number of frames that are decoded at the same time.
const MAX_DECODING = 3;

// The files of frames that are being loaded: from the file's number to the function that receives its bytes.
const arriving = new Map();

stlfr.frames = (file, text) => {
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let k = 0; k < bytes.length; k++) bytes[k] = binary.charCodeAt(k);
  arriving.get(file)?.(bytes);
};

// Loads a file of frames. Returns a promise of its bytes, decoded from base64.
function fetched(file) {
  return new Promise((resolve, reject) => {
    const script = document.createElement("script");
    const done = (settle, value) => { arriving.delete(file); script.remove(); settle(value); };
    arriving.set(file, (bytes) => done(resolve, bytes));
    script.onerror = () => done(reject, new Error("A file of this page can't be loaded."));
    script.src = `frames/${String(file).padStart(4, "0")}.js`;
    document.head.append(script);
  });
}

// Decompresses a zlib stream.
async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Decodes the depth and motion of a frame's blocks from byte planes, as `BlockMap::packed` in flow.rs writes them. A
// value is stored as its difference from a prediction: the median of the left value, the value above, and left + above
// − upper left. In the result, `flow` has the disparity plus one, the velocity (2) and the disparity's rate of change
// of each block, and `bend` has the acceleration (2). All are in quantization steps.
function unpacked(planes, width, height) {
  const count = width * height;
  if (planes.length !== 2 * CHANNELS * count) throw new Error("A file of this page is damaged.");
  const flow = new Int16Array(4 * count);
  const bend = new Int16Array(2 * count);
  const channels = [[flow, 4, 0], [flow, 4, 1], [flow, 4, 2], [bend, 2, 0], [bend, 2, 1], [flow, 4, 3]];
  channels.forEach(([to, stride, offset], channel) => {
    const low = planes.subarray(2 * channel * count);
    const high = planes.subarray((2 * channel + 1) * count);
    const row = stride * width;
    for (let y = 0, k = 0, at = offset; y < height; y++) {
      for (let x = 0; x < width; x++, k++, at += stride) {
        const left = x > 0 ? to[at - stride] : y > 0 ? to[at - row] : 0;
        const above = y > 0 ? to[at - row] : left;
        const corner = x > 0 && y > 0 ? to[at - row - stride] : above;
        const plane = left + above - corner;
        const least = Math.min(left, above);
        const most = Math.max(left, above);
        const predicted = plane < least ? least : plane > most ? most : plane;
        const residual = low[k] | (high[k] << 8);
        to[at] = predicted + ((residual >> 1) ^ -(residual & 1)); // wraps
      }
    }
  });
  return { flow, bend };
}

// Maximum ranges of disparity, and of each component of velocity per frame, in a cell of blocks, pixels. While
// something moves, such a cell is drawn as one point.
const CELL_DISPARITY_PX = 0.5;
const CELL_VELOCITY_PX = 0.5;
// Candidate sides of cells of blocks, in blocks, largest first.
const CELLS = [4, 2, 1];

// Divides a frame's map into square cells of blocks, for drawing while something moves. Cells are large where depth and
// motion hardly change. Each cell is one number, x + y · 2¹⁴ + side · 2²⁸, in blocks.
function cells(flow, width, height, steps) {
  const points = [];
  const most = [CELL_DISPARITY_PX / steps.disparity_px, CELL_VELOCITY_PX / steps.velocity_px, CELL_VELOCITY_PX / steps.velocity_px];
  const isEven = (x, y, side) => {
    const at = 4 * (y * width + x);
    for (let c = 0; c < 3; c++) {
      let low = flow[at + c];
      let high = low;
      for (let v = 0; v < side; v++) {
        for (let u = 0, k = at + 4 * v * width + c; u < side; u++, k += 4) {
          const value = flow[k];
          if (value < low) low = value;
          else if (value > high) high = value;
        }
      }
      if (high - low > most[c]) return false;
    }
    return true;
  };
  const add = (x, y, level) => {
    const side = CELLS[level];
    if (x >= width || y >= height) return;
    const isWhole = x + side <= width && y + side <= height;
    if (side === 1 || (isWhole && isEven(x, y, side))) {
      points.push(x + y * 2 ** 14 + side * 2 ** 28);
      return;
    }
    const half = CELLS[level + 1];
    for (let v = 0; v < side; v += half) for (let u = 0; u < side; u += half) add(x + u, y + v, level + 1);
  };
  for (let y = 0; y < height; y += CELLS[0]) for (let x = 0; x < width; x += CELLS[0]) add(x, y, 0);
  return new Uint32Array(points);
}

// Part of the interval between two frames of a camera during which both are blended, around the middle.
const FADING = 0.2;

// Returns the factor of a frame's weights in a view that is `dt` after it, as in placement.rs. `interval` is the time from
// the frame to the camera's frame on the other side of the view. The factors of these two frames add up to 1.
function fading(dt, interval) {
  if (interval === 0) return 1; // frames of one time have no middle
  return Math.min(Math.max((0.5 + 0.5 * FADING - Math.abs(dt / interval)) / FADING, 0), 1);
}

// All frames of the site: their files, and the frames that are in the graphics card's memory, as layers of array
// textures.
class Frames {
  constructor(gl, scene, onready) {
    this.gl = gl;
    this.scene = scene;
    this.onready = onready;
    this.all = [];
    scene.files.forEach((frames, file) => {
      let offset = 0;
      for (const [camera, time, image, flow] of frames) {
        this.all.push({ camera, time, file, image: [offset, offset + image], flow: [offset + image, offset + image + flow], layer: -1, isDecoding: false });
        offset += image + flow;
      }
    });
    const framesOf = (camera) => this.all.filter((f) => f.camera === camera.camera).sort((f, g) => f.time - g.time);
    this.cameras = scene.cameras.map((camera) => ({ ...camera, frames: framesOf(camera) }));
    this.files = new Map();
    this.decoding = 0;
    this.failure = null;
    this.wanted = [];
    const most = (of) => Math.max(...scene.cameras.map(of));
    this.size = [most((c) => c.size[0]), most((c) => c.size[1])];
    this.blocks = [most((c) => c.blocks[0]), most((c) => c.blocks[1])];
    const bytes = 4 * this.size[0] * this.size[1] + 14 * this.blocks[0] * this.blocks[1];
    const layers = Math.min(gl.getParameter(gl.MAX_ARRAY_TEXTURE_LAYERS), Math.floor(MAX_FRAME_BYTES / bytes));
    // At least twice the maximum number of frames of a view, so that frames of the next instant have room too.
    this.layers = new Array(Math.min(this.all.length, Math.max(2 * MAX_SOURCES, layers))).fill(null);
    const texture = (format, [width, height], filter) => arrayTexture(gl, format, [width, height, this.layers.length], filter);
    this.images = texture(gl.RGBA8, this.size, gl.LINEAR);
    this.flows = texture(gl.RGBA16I, this.blocks, gl.NEAREST);
    this.bends = texture(gl.RG16I, this.blocks, gl.NEAREST);
    this.trusts = texture(gl.RG8, this.blocks, gl.NEAREST);
  }

  // Returns the frames from which the view at `center` and `time` is blended, and the factors of their weights. They
  // belong to the nearest cameras that film at this time, the nearest camera first. From each camera, the frame nearest
  // in time is taken. If the quality level `fades`, both frames are taken around the middle between two frames of a
  // camera, as far as MAX_SOURCES allows.
  of(center, time, { cameras: most, fades }) {
    const films = (c) => !c.filmed || (time >= c.filmed[0] && time <= c.filmed[1]);
    const away = (c) => Math.hypot(...c.center.map((v, k) => v - center[k]));
    const near = this.cameras.filter(films).map((camera) => ({ camera, distance: away(camera) }));
    const cameras = near.sort((p, q) => p.distance - q.distance).slice(0, most);
    let left = fades ? MAX_SOURCES - cameras.length : 0;
    return cameras.flatMap(({ camera, distance }) => {
      const { frames } = camera;
      const k = frames.reduce((best, f, n) => (Math.abs(f.time - time) < Math.abs(frames[best].time - time) ? n : best), 0);
      const source = (frame, factor) => ({ camera, frame, distance, fading: factor });
      const dt = time - frames[k].time;
      const other = frames[dt >= 0 ? k + 1 : k - 1];
      const own = other && left > 0 ? fading(dt, other.time - frames[k].time) : 1;
      if (own === 1) return [source(frames[k], 1)];
      left -= 1;
      return [source(frames[k], own), source(other, 1 - own)];
    });
  }

  // Requests the frames `first`. If `all` is true, also requests the frames nearest to `time`, as far as there are
  // layers for them.
  want(first, time, all) {
    const rest = all ? [...this.all].sort((f, g) => Math.abs(f.time - time) - Math.abs(g.time - time)) : [];
    this.wanted = [...new Set([...first, ...rest])].slice(0, this.layers.length);
    this.proceed();
  }

  get fraction() { return this.all.filter((f) => f.layer >= 0).length / this.layers.length; }

  proceed() {
    for (const frame of this.wanted) {
      if (this.decoding >= MAX_DECODING || this.failure) return;
      if (frame.layer < 0 && !frame.isDecoding) this.decode(frame);
    }
  }

  async decode(frame) {
    frame.isDecoding = true;
    this.decoding += 1;
    try {
      if (!this.files.has(frame.file)) this.files.set(frame.file, fetched(frame.file));
      const bytes = await this.files.get(frame.file);
      const camera = this.cameras.find((c) => c.camera === frame.camera);
      const image = new Blob([bytes.subarray(...frame.image)], { type: "image/jpeg" });
      const [bitmap, planes] = await Promise.all([
        createImageBitmap(image, { colorSpaceConversion: "none", premultiplyAlpha: "none" }),
        inflated(bytes.subarray(...frame.flow)),
      ]);
      this.upload(frame, bitmap, unpacked(planes, ...camera.blocks), camera);
      bitmap.close();
    } catch (error) {
      this.failure = error;
    }
    frame.isDecoding = false;
    this.decoding -= 1;
    this.onready(this.failure);
    this.proceed();
  }

  upload(frame, bitmap, { flow, bend }, { blocks: [width, height] }) {
    const gl = this.gl;
    const layer = this.freeLayer();
    const into = (texture) => gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
    gl.activeTexture(gl.TEXTURE0);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    into(this.images);
    gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, 0, layer, bitmap.width, bitmap.height, 1, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
    into(this.flows);
    gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, 0, layer, width, height, 1, gl.RGBA_INTEGER, gl.SHORT, flow);
    into(this.bends);
    gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, 0, layer, width, height, 1, gl.RG_INTEGER, gl.SHORT, bend);
    frame.points ??= gl.createBuffer();
    const points = cells(flow, width, height, this.scene.steps);
    gl.bindBuffer(gl.ARRAY_BUFFER, frame.points);
    gl.bufferData(gl.ARRAY_BUFFER, points, gl.STATIC_DRAW);
    frame.pointCount = points.length;
    this.layers[layer] = frame;
    frame.layer = layer;
    frame.trust = null;
  }

  // Returns the index of a layer for a new frame. It is a layer without a frame, or else that of a frame that isn't
  // wanted, or else that of the wanted frame with the lowest priority. A frame in the layer is evicted.
  freeLayer() {
    const free = this.layers.indexOf(null);
    if (free >= 0) return free;
    const rank = (frame) => { const k = this.wanted.indexOf(frame); return k < 0 ? Infinity : k; };
    let worst = 0;
    this.layers.forEach((frame, layer) => { if (rank(frame) > rank(this.layers[worst])) worst = layer; });
    this.layers[worst].layer = -1;
    return worst;
  }
}

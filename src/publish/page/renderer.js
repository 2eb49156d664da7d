"use strict";

function arrayTexture(gl, format, [width, height, layers], filter) {
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
  gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, format, width, height, layers);
  setSampling(gl, gl.TEXTURE_2D_ARRAY, filter);
  return texture;
}

function flatTexture(gl, format, [width, height], filter) {
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
  setSampling(gl, gl.TEXTURE_2D, filter);
  return texture;
}

function setSampling(gl, target, filter) {
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(target, name, filter);
  for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(target, name, gl.CLAMP_TO_EDGE);
}

// A shader program, and its uniforms by name.
class Program {
  constructor(gl, vertex, fragment) {
    this.gl = gl;
    this.program = gl.createProgram();
    this.shaders = [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]].map(([kind, source]) => {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(this.program, shader);
      return shader;
    });
    gl.linkProgram(this.program);
  }

  // Returns the program's uniforms by name. They are looked up when the program is first used, so that the browser can
  // compile all programs at the same time.
  get uniforms() {
    if (this.found) return this.found;
    const gl = this.gl;
    if (!gl.getProgramParameter(this.program, gl.LINK_STATUS)) {
      const log = this.shaders.map((s) => gl.getShaderInfoLog(s)).join(" ");
      throw new Error(`This browser can't draw the page: ${gl.getProgramInfoLog(this.program)} ${log}`);
    }
    this.found = {};
    const count = gl.getProgramParameter(this.program, gl.ACTIVE_UNIFORMS);
    for (let k = 0; k < count; k++) {
      const { name, type } = gl.getActiveUniform(this.program, k);
      this.found[name.replace("[0]", "")] = { at: gl.getUniformLocation(this.program, name), type };
    }
    return this.found;
  }

  use(values, textures) {
    const gl = this.gl;
    const uniforms = this.uniforms;
    gl.useProgram(this.program);
    for (const [name, value] of Object.entries(values)) {
      const uniform = uniforms[name];
      const list = typeof value === "number" || typeof value === "boolean" ? [Number(value)] : value;
      if (!uniform || list.length === 0) continue;
      switch (uniform.type) {
        case gl.FLOAT: gl.uniform1fv(uniform.at, list); break;
        case gl.FLOAT_VEC2: gl.uniform2fv(uniform.at, list); break;
        case gl.FLOAT_VEC3: gl.uniform3fv(uniform.at, list); break;
        case gl.FLOAT_VEC4: gl.uniform4fv(uniform.at, list); break;
        case gl.FLOAT_MAT3: gl.uniformMatrix3fv(uniform.at, false, list); break;
        case gl.INT_VEC2: gl.uniform2iv(uniform.at, list); break;
        default: gl.uniform1iv(uniform.at, list);
      }
    }
    Object.entries(textures).forEach(([name, [target, texture]], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(target, texture);
      if (uniforms[name]) gl.uniform1i(uniforms[name].at, unit);
    });
  }
}

// Draws views in three passes: it splats each frame to candidates, blends the candidates, and fills the holes.
class Renderer {
  constructor(canvas, scene, onready) {
    this.canvas = canvas;
    const wanted = { alpha: false, antialias: false, depth: false, powerPreference: "high-performance" };
    const gl = canvas.getContext("webgl2", wanted);
    if (!gl) throw new Error("This page needs WebGL 2, which this browser doesn't give.");
    this.gl = gl;
    this.scene = scene;
    this.programs = {
      confidence: new Program(gl, WHOLE, CONFIDENCE),
      splat: new Program(gl, SPLAT_VERTEX, SPLAT),
      quick: this.sampling(HEAD),
      show: new Program(gl, WHOLE, SHOW),
    };
    this.frames = new Frames(gl, scene, onready);
    gl.bindVertexArray(gl.createVertexArray());
    gl.disable(gl.DITHER);
    // Value of the vertex attribute for points that are drawn without an array of cells.
    gl.vertexAttribI4ui(0, 0, 0, 0, 0);
    this.framebuffer = gl.createFramebuffer();
    this.targets = null;
    // A viewpoint nearer to the scene than the cameras sees larger inverse depths than any frame.
    this.maxInverseDepth = 2 * Math.max(scene.max_inverse_depth, 1e-9);
    this.maxPoint = gl.getParameter(gl.ALIASED_POINT_SIZE_RANGE)[1];
    const { steps } = scene;
    this.map = { steps: [steps.disparity_px, steps.velocity_px, steps.acceleration_px, steps.rate_px], block_px: steps.block_px };
  }

  // Creates the programs that sample images. Their shaders begin with `head`, which chooses the interpolation.
  sampling(head) {
    return { blend: new Program(this.gl, WHOLE, head + BLEND), fill: new Program(this.gl, WHOLE, head + FILL) };
  }

  // Creates the textures for views of this size: candidates, blended picture with depths, and filled picture.
  resize([width, height]) {
    const gl = this.gl;
    if (this.targets && this.targets.size[0] === width && this.targets.size[1] === height) return;
    if (this.targets) {
      for (const name of ["candidates", "colors", "depths", "filled"]) gl.deleteTexture(this.targets[name]);
      gl.deleteRenderbuffer(this.targets.hidden);
    }
    const large = [width + 2 * MARGIN, height + 2 * MARGIN];
    const hidden = gl.createRenderbuffer();
    gl.bindRenderbuffer(gl.RENDERBUFFER, hidden);
    gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT24, ...large);
    this.targets = {
      size: [width, height],
      large,
      hidden,
      candidates: arrayTexture(gl, gl.RGBA16UI, [...large, MAX_SOURCES], gl.NEAREST),
      colors: flatTexture(gl, gl.RGBA8, [width, height], gl.NEAREST),
      depths: flatTexture(gl, gl.R16UI, [width, height], gl.NEAREST),
      filled: flatTexture(gl, gl.RGBA8, [width, height], gl.LINEAR),
    };
  }

  // Binds the framebuffer for drawing into the textures that the function `attach` attaches. `count` is the number of
  // colour attachments.
  into(attach, [width, height], count = 1) {
    const gl = this.gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    for (const point of [gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1]) gl.framebufferTexture2D(gl.FRAMEBUFFER, point, gl.TEXTURE_2D, null, 0);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, null);
    attach();
    gl.drawBuffers(count === 2 ? [gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1] : [gl.COLOR_ATTACHMENT0]);
    gl.viewport(0, 0, width, height);
  }

  layer(texture, layer) {
    const gl = this.gl;
    return () => gl.framebufferTextureLayer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, texture, 0, layer);
  }

  flat(texture, index = 0) {
    const gl = this.gl;
    return () => gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + index, gl.TEXTURE_2D, texture, 0);
  }

  get mapTextures() {
    const { gl, frames } = this;
    const array = gl.TEXTURE_2D_ARRAY;
    return { flows: [array, frames.flows], bends: [array, frames.bends] };
  }

  // Computes the confidences of frames that are blended together. If `anySet` is true, confidences that were computed
  // together with other frames are reused.
  trust(sources, anySet) {
    const gl = this.gl;
    const key = sources.map(({ frame }) => frame.layer + ":" + frame.time).sort().join();
    for (const source of sources) {
      const { frame, camera } = source;
      if (frame.trust === key || (anySet && frame.trust)) continue;
      const others = sources.filter((o) => o !== source && Math.abs(o.frame.time - frame.time) <= MAX_CONFIRMING_DT);
      const between = others.map((o) => projection(camera, o.camera));
      this.into(this.layer(this.frames.trusts, frame.layer), camera.blocks);
      this.programs.confidence.use({
        ...this.map,
        own: frame.layer,
        blocks: camera.blocks,
        own_disparity_px: camera.disparity_px,
        count: others.length,
        layers: others.map((o) => o.frame.layer),
        a: between.flatMap((p) => p.a),
        b: between.flatMap((p) => p.b),
        dt: others.map((o) => o.frame.time - frame.time),
        sizes: others.flatMap((o) => o.camera.size),
        disparities_px: others.map((o) => o.camera.disparity_px),
      }, this.mapTextures);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
      frame.trust = key;
    }
  }

  // Draws a view into `targets.filled`. All frames of `sources` must be loaded.
  draw(view, time, sources, quality) {
    const gl = this.gl;
    this.resize(view.size);
    gl.disable(gl.BLEND);
    this.trust(sources, quality.anyTrust);
    this.splat(view, time, sources, quality.hasCells);
    const { candidates, colors, depths, filled, size } = this.targets;
    const layers = sources.map((s) => s.frame.layer);
    const sizes = sources.flatMap((s) => s.camera.size);
    const disparities = sources.map((s) => s.camera.disparity_px);
    const images = [gl.TEXTURE_2D_ARRAY, this.frames.images];
    const shared = { count: sources.length, layers, sizes };
    // The programs with cubic interpolation are compiled when they are first used, so that the first picture appears
    // sooner.
    const programs = quality.isCubic ? (this.programs.fine ??= this.sampling(`${HEAD}#define IS_CUBIC\n`)) : this.programs.quick;
    this.into(() => { this.flat(colors)(); this.flat(depths, 1)(); }, size, 2);
    programs.blend.use({
      ...shared,
      is_color: sources.map((s) => Number(s.camera.is_color)),
      reach: CLUSTER_PX / Math.max(...disparities) / this.maxInverseDepth,
    }, { candidates: [gl.TEXTURE_2D_ARRAY, candidates], images });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    const between = sources.map((s) => projection(view, s.camera));
    this.into(this.flat(filled), size);
    programs.fill.use({
      ...this.map,
      ...shared,
      size,
      max_inverse_depth: this.maxInverseDepth,
      a: between.flatMap((p) => p.a),
      b: between.flatMap((p) => p.b),
      disparities_px: disparities,
    }, { colors: [gl.TEXTURE_2D, colors], depths: [gl.TEXTURE_2D, depths], images, ...this.mapTextures });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  splat(view, time, sources, hasCells) {
    const gl = this.gl;
    const { candidates, hidden, large } = this.targets;
    const focal = mean(view.lens.slice(0, 2));
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LESS);
    sources.forEach(({ camera, frame, distance, fading }, index) => {
      this.into(() => {
        this.layer(candidates, index)();
        gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, hidden);
      }, large);
      gl.clearBufferuiv(gl.COLOR, 0, [0, 0, 0, 0]);
      gl.clearBufferfv(gl.DEPTH, 0, [1]);
      const { a, b } = projection(camera, view);
      this.programs.splat.use({
        ...this.map,
        layer: frame.layer,
        blocks: camera.blocks,
        has_cells: hasCells,
        disparity_px: camera.disparity_px,
        a,
        b,
        dt: time - frame.time,
        fading,
        size: view.size,
        zoom: focal / mean(camera.lens.slice(0, 2)),
        baseline_px: focal * distance,
        max_inverse_depth: this.maxInverseDepth,
        max_point_px: this.maxPoint,
        frame_size: camera.size,
        max_score: this.maxInverseDepth * camera.disparity_px / HIDING_PX,
      }, { ...this.mapTextures, trusts: [gl.TEXTURE_2D_ARRAY, this.frames.trusts] });
      if (hasCells) {
        gl.enableVertexAttribArray(0);
        gl.bindBuffer(gl.ARRAY_BUFFER, frame.points);
        gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
      }
      gl.drawArrays(gl.POINTS, 0, hasCells ? frame.pointCount : camera.blocks[0] * camera.blocks[1]);
      gl.disableVertexAttribArray(0);
    });
    gl.disable(gl.DEPTH_TEST);
  }

  // Shows the last view in the middle of the canvas. `shown` is its width and height there, pixels.
  show(shown) {
    const gl = this.gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    const origin = [this.canvas.width - shown[0], this.canvas.height - shown[1]].map((v) => Math.floor(v / 2));
    gl.clearColor(0.0706, 0.0745, 0.0784, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.viewport(...origin, ...shown);
    this.programs.show.use({ size: this.targets.size, shown, origin }, { colors: [gl.TEXTURE_2D, this.targets.filled] });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  // Returns the last view as a canvas. It is transparent where no camera has image content.
  picture() {
    const gl = this.gl;
    const [width, height] = this.targets.size;
    this.into(this.flat(this.targets.filled), [width, height]);
    const pixels = new Uint8ClampedArray(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    const canvas = Object.assign(document.createElement("canvas"), { width, height });
    canvas.getContext("2d").putImageData(new ImageData(pixels, width, height), 0, 0);
    return canvas;
  }
}

const MAX_CONFIRMING_DT = 0.8;
const CLUSTER_PX = 1.5;
const HIDING_PX = 0.5;

const mean = (values) => values.reduce((sum, v) => sum + v, 0) / values.length;

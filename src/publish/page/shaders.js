"use strict";

// Shaders with the computations of agreements.rs, confidence.rs, map.rs, placement.rs, splat.rs, composite.rs, robust_mean.rs and
// blend.rs in src/scene_flow. Constants have the same names and values as there.

// Maximum number of frames from which a view is blended: those of 8 cameras, and the second frames of cameras of which
// two frames are blended.
const MAX_SOURCES = 10;
// Margin around a view in the texture of candidates, pixels. A splat whose centre is outside of the texture is not
// drawn at all, even if the splat extends into the view.
const MARGIN = 8;

const HEAD = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp sampler2DArray;
precision highp isampler2DArray;
precision highp usampler2D;
precision highp usampler2DArray;
#define MAX_SOURCES ${MAX_SOURCES}
#define MARGIN ${MARGIN}
`;

// Reads the map of a frame. In quantization steps, `flows` holds the disparity plus one, the velocity and the
// disparity's rate of change, and `bends` holds the acceleration. `trusts` holds the confidence, and the sides of a
// block beyond which there is another surface.
const MAP = `
uniform isampler2DArray flows;
uniform isampler2DArray bends;
uniform sampler2DArray trusts;
uniform vec4 steps;
uniform float block_px;

struct Element { float inverse_depth; vec2 velocity; vec2 acceleration; float rate; bool is_filmed; };

Element element(ivec3 at, float disparity_px) {
  ivec4 flow = texelFetch(flows, at, 0);
  ivec2 bend = texelFetch(bends, at, 0).xy;
  float per_px = 1.0 / disparity_px;
  return Element(max(float(flow.x - 1), 0.0) * steps.x * per_px, vec2(flow.yz) * steps.y, vec2(bend) * steps.z,
    float(flow.w) * steps.w * per_px, flow.x > 0);
}

vec3 moved(Element e, vec2 pixel, float dt) {
  return vec3(pixel + e.velocity * dt + e.acceleration * (0.5 * dt * dt), e.inverse_depth + e.rate * dt);
}

// A pixel and its inverse depth in another camera; far outside if it is behind that.
vec3 projected(mat3 a, vec3 b, vec3 point) {
  vec3 h = a * vec3(point.xy, 1.0) + point.z * b;
  return h.z < 1e-6 ? vec3(-1e9, -1e9, 0.0) : vec3(h.xy, point.z) / h.z;
}
`;

const WHOLE = `${HEAD}
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`;

// Computes the confidence of each block of a frame, and the block's sides beyond which there is another surface.
const CONFIDENCE = `${HEAD}${MAP}
uniform int own;
uniform ivec2 blocks;
uniform float own_disparity_px;
uniform int count;
uniform int layers[MAX_SOURCES];
uniform mat3 a[MAX_SOURCES];
uniform vec3 b[MAX_SOURCES];
uniform float dt[MAX_SOURCES];
uniform vec2 sizes[MAX_SOURCES];
uniform float disparities_px[MAX_SOURCES];
out vec4 found;

const float MAX_DISPARITY_ERROR_PX = 1.5;
const float MAX_MOTION_ERROR_PX = 2.0;
const float MAX_MOTION_ERROR = 0.15;
const float HIDDEN = 0.3;
const float PRIOR_CONFIRMED = 0.1;
const float PRIOR_ALL = 0.5;
const float MAX_JUMP_PX = 1.0;
const float JUMP_FRAMES = 0.5;

float jump(ivec2 at, ivec2 side) {
  ivec2 beside = at + side;
  if (any(lessThan(beside, ivec2(0))) || any(greaterThanEqual(beside, blocks))) return 0.0;
  vec3 difference = abs(vec3(texelFetch(flows, ivec3(at, own), 0).xyz - texelFetch(flows, ivec3(beside, own), 0).xyz));
  return difference.x * steps.x + JUMP_FRAMES * steps.y * (difference.y + difference.z) > MAX_JUMP_PX ? 1.0 : 0.0;
}

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  Element e = element(ivec3(at, own), own_disparity_px);
  vec2 pixel = (vec2(at) + 0.5) * block_px;
  float confirmed = PRIOR_CONFIRMED;
  float all = PRIOR_ALL;
  for (int k = 0; k < count; k++) {
    vec3 from = moved(e, pixel, dt[k]);
    vec3 here = projected(a[k], b[k], from);
    if (here.x < 0.0 || here.y < 0.0 || here.x >= sizes[k].x || here.y >= sizes[k].y) continue;
    vec3 next = projected(a[k], b[k], from + vec3(e.velocity + dt[k] * e.acceleration, e.rate));
    Element there = element(ivec3(ivec2(here.xy / block_px), layers[k]), disparities_px[k]);
    if (!there.is_filmed) continue;
    float disparity = (there.inverse_depth - here.z) * own_disparity_px;
    vec2 velocity = next.xy - here.xy;
    bool is_like = distance(there.velocity, velocity) < MAX_MOTION_ERROR_PX + MAX_MOTION_ERROR * length(velocity);
    if (abs(disparity) < MAX_DISPARITY_ERROR_PX && is_like) confirmed += 1.0;
    all += disparity < MAX_DISPARITY_ERROR_PX ? 1.0 : HIDDEN;
  }
  float sides = jump(at, ivec2(-1, 0)) + 2.0 * jump(at, ivec2(1, 0)) + 4.0 * jump(at, ivec2(0, -1)) + 8.0 * jump(at, ivec2(0, 1));
  found = vec4(max(confirmed / all, 1.0 / 255.0), sides / 255.0, 0.0, 0.0);
}`;

// Draws a point for every block, or for every cell of similar blocks. The point is moved to the view's instant and
// projected into the view.
const SPLAT_VERTEX = `${HEAD}${MAP}
uniform int layer;
uniform ivec2 blocks;
uniform bool has_cells;
layout(location = 0) in uint cell_of_blocks;
uniform float disparity_px;
uniform mat3 a;
uniform vec3 b;
uniform float dt;
uniform float fading;
uniform vec2 size;
uniform float zoom;
uniform float baseline_px;
uniform float max_inverse_depth;
uniform float max_point_px;
flat out vec4 place;
flat out vec4 sides;
flat out vec3 value;

const float HALF_WIDTH = 0.55;
const float HALF_WIDTH_AT_EDGE = 0.5;
const vec2 SCALES = vec2(0.8, 8.0);
const float ERROR_PX = 0.2;
const float ERROR_BY_BASELINE = 0.005;
const vec2 ERROR_BY_TIME = vec2(0.03, 0.009);
const float EXACT_PX = 0.01;

void main() {
  ivec2 cell = ivec2(gl_VertexID % blocks.x, gl_VertexID / blocks.x);
  int stride = 1;
  if (has_cells) {
    cell = ivec2(cell_of_blocks & 16383u, (cell_of_blocks >> 14) & 16383u);
    stride = int(cell_of_blocks >> 28);
  }
  ivec3 at = ivec3(cell + stride / 2, layer);
  Element e = element(at, disparity_px);
  float cell_px = float(stride) * block_px;
  vec2 pixel = (vec2(cell) + 0.5 * float(stride)) * block_px;
  vec3 from = moved(e, pixel, dt);
  vec3 to = projected(a, b, from);
  float scale = zoom * clamp(to.z / max(from.z, 1e-30), SCALES.x, SCALES.y);
  vec2 limit = vec2(scale * cell_px);
  gl_PointSize = 1.0;
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  bool is_near = all(greaterThan(to.xy, -limit)) && all(lessThan(to.xy, size + limit));
  if (!is_near || to.z <= 0.0 || !e.is_filmed) return;
  vec2 trust = texelFetch(trusts, at, 0).xy;
  int edges = stride > 1 ? 0 : int(trust.y * 255.0 + 0.5);
  float inner = 0.5 * (cell_px - 1.0);
  vec4 is_edge = vec4(edges & 1, (edges >> 1) & 1, (edges >> 2) & 1, (edges >> 3) & 1);
  sides = scale * (inner + mix(vec4(HALF_WIDTH), vec4(HALF_WIDTH_AT_EDGE), is_edge));
  gl_PointSize = min(2.0 * scale * (inner + HALF_WIDTH), max_point_px);
  gl_Position = vec4(2.0 * (to.xy + float(MARGIN)) / (size + 2.0 * float(MARGIN)) - 1.0, 0.0, 1.0);
  place = vec4(to.xy + float(MARGIN), pixel);
  float speed = length(e.velocity);
  float error = ERROR_BY_BASELINE * baseline_px * to.z;
  float motion = dt * (ERROR_BY_TIME.x + ERROR_BY_TIME.y * speed);
  float own = max(error * error + motion * motion, 1.1920929e-7);
  float exact = 1.0 + EXACT_PX * EXACT_PX / own;
  float weight = fading * trust.x * trust.x * exact / (ERROR_PX * ERROR_PX + own);
  value = vec3(scale, to.z / max_inverse_depth, (log2(weight) + 32.0) / 64.0);
}`;

// Writes a splat's candidate for a pixel of the view: the position in the frame, the inverse depth, and the weight. Of
// a frame's candidates for a pixel, the nearest surface remains; at equal depths, the candidate with the nearest
// centre.
const SPLAT = `${HEAD}
uniform vec2 frame_size;
uniform float max_score;
flat in vec4 place;
flat in vec4 sides;
flat in vec3 value;
out uvec4 candidate;

void main() {
  vec2 from = gl_FragCoord.xy - place.xy;
  if (from.x < -sides.x || from.x > sides.y || from.y < -sides.z || from.y > sides.w) discard;
  float away = max(abs(from.x), abs(from.y)) / max(max(sides.x, sides.y), max(sides.z, sides.w));
  gl_FragDepth = clamp(1.0 - (value.y * max_score + 1.0 - away) / (max_score + 1.0), 0.0, 1.0);
  vec2 source = clamp((place.zw + from / value.x) / frame_size, 0.0, 1.0);
  candidate = uvec4(clamp(vec4(source, value.yz), 0.0, 1.0) * 65535.0 + 0.5);
}`;

const SAMPLING = `
uniform sampler2DArray images;

vec3 bilinear(vec2 at, int layer) { return texture(images, vec3(at / vec2(textureSize(images, 0).xy), layer)).rgb; }

#ifdef IS_CUBIC
// Catmull and Rom's cubic, of nine bilinear samples; of a frame of this size, at a pixel.
vec3 image(vec2 at, int layer, vec2 size) {
  vec2 middle = floor(at - 0.5) + 0.5;
  vec2 f = at - middle;
  vec2 w[3] = vec2[](f * (-0.5 + f * (1.0 - 0.5 * f)), 1.0 + f * f * (-2.5 + 1.5 * f) + f * (0.5 + f * (2.0 - 1.5 * f)), f * f * (-0.5 + 0.5 * f));
  vec2 low = vec2(0.5);
  vec2 high = size - 0.5;
  vec2 p[3] = vec2[](clamp(middle - 1.0, low, high), clamp(middle + f * (0.5 + f * (2.0 - 1.5 * f)) / w[1], low, high), clamp(middle + 2.0, low, high));
  vec3 sum = vec3(0.0);
  ${[0, 1, 2].map((y) => [0, 1, 2].map((x) => `sum += w[${x}].x * w[${y}].y * bilinear(vec2(p[${x}].x, p[${y}].y), layer);`).join(" ")).join("\n  ")}
  return sum;
}
#else
vec3 image(vec2 at, int layer, vec2 size) { return bilinear(clamp(at, vec2(0.5), size - 0.5), layer); }
#endif
`;

// Repeats a statement for each source k. Array indices in the shader are thus constant. Without a graphics card,
// constant indices are several times as fast as variable indices. Groups of sources that a view doesn't have are skipped.
const GROUP = 4;
const each = (statement) => {
  const groups = Array.from({ length: Math.ceil(MAX_SOURCES / GROUP) }, (_, group) => {
    const sources = Array.from({ length: Math.min(GROUP, MAX_SOURCES - GROUP * group) }, (_, k) => GROUP * group + k);
    const statements = sources.map((k) => `  ${statement.replaceAll("[k]", `[${k}]`)}`).join("\n");
    return group === 0 ? statements : `  if (count > ${GROUP * group}) {\n${statements}\n  }`;
  });
  return groups.join("\n");
};

// Blends the candidates of a pixel: it shows the nearest cluster with enough weight, and what is visible through it.
const BLEND = `${SAMPLING}
uniform usampler2DArray candidates;
uniform int count;
uniform int layers[MAX_SOURCES];
uniform vec2 sizes[MAX_SOURCES];
uniform bool is_color[MAX_SOURCES];
uniform float reach;
layout(location = 0) out vec4 color;
layout(location = 1) out uint depth;

const float FRONT = 0.12;
const float OPAQUE = 0.25;
const float BEHIND = 0.05;
const float MIN_FRACTION = 0.02;
const float COLOR = 0.06;

vec2 sources[MAX_SOURCES];
float depths[MAX_SOURCES];
// 0 where a frame has no candidate.
float weights[MAX_SOURCES];
// Weight of the cluster around each candidate; 0 where a frame has no candidate.
float supports[MAX_SOURCES];
float clustered[MAX_SOURCES];
vec3 colors[MAX_SOURCES];

void read(ivec2 at, int k, vec2 size, out vec2 source, out float found_depth, out float weight) {
  source = vec2(0.0);
  found_depth = -1e9;
  weight = 0.0;
  if (k >= count) return;
  uvec4 found = texelFetch(candidates, ivec3(at, k), 0);
  if (found.w == 0u) return;
  source = vec2(found.xy) / 65535.0 * size;
  found_depth = float(found.z) / 65535.0;
  weight = exp2(float(found.w) / 65535.0 * 64.0 - 32.0);
}

float support(float q) {
  float sum = 0.0;
${each("if (abs(depths[k] - q) < reach) sum += weights[k];")}
  return sum;
}

// Depth and weight of the heaviest cluster between two depths, of the supports.
vec2 heaviest(float from, float to) {
  vec2 best = vec2(0.0);
${each("if (depths[k] > from && depths[k] < to && supports[k] > best.y) best = vec2(depths[k], supports[k]);")}
  return best;
}

// The mean of a cluster, and its depth; colours that differ count less.
vec4 mean_of(float q) {
  bool has_color = false;
  float most = 0.0;
${each("clustered[k] = abs(depths[k] - q) < reach ? weights[k] : 0.0;")}
${each("has_color = has_color || (clustered[k] > 0.0 && is_color[k]);")}
${each("if (is_color[k] != has_color) clustered[k] = 0.0;")}
${each("most = max(most, clustered[k]);")}
${each("if (clustered[k] < MIN_FRACTION * most) clustered[k] = 0.0;")}
${each("colors[k] = vec3(0.0); if (clustered[k] > 0.0) colors[k] = image(sources[k], layers[k], sizes[k]);")}
  vec4 sum = vec4(0.0);
  float near = 0.0;
${each("sum += clustered[k] * vec4(colors[k], 1.0); near += clustered[k] * depths[k];")}
  vec3 mean = sum.rgb / sum.a;
  near /= sum.a;
  vec3 difference;
  float kept;
  for (int round = 0; round < 2; round++) {
    sum = vec4(0.0);
${each("difference = colors[k] - mean; kept = 1.0 / (1.0 + dot(difference, difference) / (COLOR * COLOR)); sum += clustered[k] * kept * kept * vec4(colors[k], 1.0);")}
    mean = sum.rgb / sum.a;
  }
  return vec4(clamp(mean, 0.0, 1.0), near);
}

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy) + MARGIN;
  float nearest = 0.0;
  float farthest = 1e9;
  float total = 0.0;
${Array.from({ length: MAX_SOURCES }, (_, k) => `  read(at, ${k}, sizes[${k}], sources[${k}], depths[${k}], weights[${k}]);`).join("\n")}
${each("if (weights[k] > 0.0) { nearest = max(nearest, depths[k]); farthest = min(farthest, depths[k]); total += weights[k]; }")}
  color = vec4(0.0);
  depth = 0u;
  if (total == 0.0) return;
  float shown = nearest;
  float behind = 0.0;
  float opacity = 1.0;
  if (nearest - farthest >= reach) {
${each("supports[k] = weights[k] > 0.0 ? support(depths[k]) : 0.0;")}
    vec2 best = heaviest(-1e8, 1e8);
    float front = best.x;
${each("if (depths[k] > front && supports[k] > FRONT * total) front = depths[k];")}
    if (front > best.x) best = heaviest(front - reach, front + reach);
    shown = best.x;
    vec2 back = heaviest(-1e8, shown - 2.0 * reach);
    if (back.y > BEHIND * total) opacity = clamp((best.y / total - FRONT) / (OPAQUE - FRONT), 0.0, 1.0);
    behind = back.x;
  }
  // A loop over the cluster in front and the one behind it, so that mean_of is compiled once. Without a graphics card,
  // compilation takes most of the time to the first picture.
  for (int layer = 0; layer < 2; layer++) {
    vec4 found = mean_of(layer == 0 ? shown : behind);
    if (layer == 1) {
      color.rgb = mix(found.rgb, color.rgb, opacity);
      return;
    }
    color = vec4(found.rgb, 1.0);
    depth = uint(clamp(found.w * 65535.0 + 0.5, 1.0, 65535.0));
    if (opacity >= 1.0) return;
  }
}`;

// Fills holes, which are pixels without candidates. A hole gets the depth of the farthest surface at its border, and
// the colour from the nearest camera's frame that shows this depth.
const FILL = `${MAP}${SAMPLING}
uniform sampler2D colors;
uniform usampler2D depths;
uniform ivec2 size;
uniform float max_inverse_depth;
uniform int count;
uniform int layers[MAX_SOURCES];
uniform vec2 sizes[MAX_SOURCES];
uniform mat3 a[MAX_SOURCES];
uniform vec3 b[MAX_SOURCES];
uniform float disparities_px[MAX_SOURCES];
out vec4 color;

const float CLUSTER_PX = 1.5;
// Pixels in each direction in which the border of a hole is searched.
const int MAX_STEPS = 40;

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  color = texelFetch(colors, at, 0);
  if (color.a > 0.0) return;
  uint far = 0u;
  int limit = MAX_STEPS;
  for (int steps_px = 1; steps_px <= limit; steps_px++) {
    for (int y = -1; y <= 1; y++) for (int x = -1; x <= 1; x++) {
      ivec2 there = at + ivec2(x, y) * steps_px;
      if (any(lessThan(there, ivec2(0))) || any(greaterThanEqual(there, size))) continue;
      uint found = texelFetch(depths, there, 0).x;
      if (found == 0u || (far > 0u && found >= far)) continue;
      if (far == 0u) limit = min(limit, 2 * steps_px);
      far = found;
      color = texelFetch(colors, there, 0);
    }
  }
  if (far == 0u) return;
  vec3 point = vec3(vec2(at) + 0.5, float(far) / 65535.0 * max_inverse_depth);
  bool is_filmed = false;
  for (int k = 0; k < count; k++) {
    vec3 there = projected(a[k], b[k], point);
    if (there.x < 0.0 || there.y < 0.0 || there.x >= sizes[k].x || there.y >= sizes[k].y) continue;
    Element e = element(ivec3(ivec2(there.xy / block_px), layers[k]), disparities_px[k]);
    if (!e.is_filmed) continue;
    is_filmed = true;
    if ((e.inverse_depth - there.z) * disparities_px[k] < CLUSTER_PX) {
      color = vec4(clamp(image(there.xy, layers[k], sizes[k]), 0.0, 1.0), 1.0);
      return;
    }
  }
  if (!is_filmed) color = vec4(0.0);
}`;

// Draws the view into a rectangle of the canvas, over the page's background colour.
const SHOW = `${HEAD}
uniform sampler2D colors;
uniform vec2 size;
uniform vec2 shown;
uniform vec2 origin;
out vec4 color;

void main() {
  vec2 at = gl_FragCoord.xy - origin;
  at = vec2(at.x, shown.y - at.y) / shown * size;
  vec4 found = size == shown ? texelFetch(colors, ivec2(at), 0) : texture(colors, at / size);
  color = vec4(mix(vec3(0.0706, 0.0745, 0.0784), found.rgb, found.a), 1.0);
}`;

// The page: connects controls, keys and the link to the state, and the state to the pictures.

import { Legend } from "./legend.js";
import { RigMap } from "./map.js";
import { Plan } from "./plan.js";
import { command, copy, returnCommand, saveCamera, savePicture } from "./save.js";
import { Pane, gestures } from "./stage.js";
import { METHODS, State, WORDS, truthName } from "./state.js";
import { Stream, fullSize } from "./stream.js";

const byId = (id) => document.getElementById(id);
/** Duration for which a message is shown, milliseconds. */
const TOAST_MS = 6000;
/** Delay of updates of the link after a change, and interval of updates of the frame rate, milliseconds. */
const SETTLE_MS = 400;
/** Duration of one movement along the cameras and back while time stands still, seconds. */
const ORBIT_S = 7;
/** Minimum duration of the playback, seconds. The initial speed is the fastest that satisfies it. */
const MIN_LOOP_S = 3;
/** Interval at which a page at rest checks whether the server can be reached, milliseconds. */
const HEARTBEAT_MS = 4000;
const ENDED = "The server has ended, or can’t be reached.";

let state, map, plan, legend, scene;
const panes = [new Pane(byId("pane-a")), new Pane(byId("pane-b"))];
const size = () => fullSize(scene.lens, byId("picture").clientWidth);
/** Size of a saved picture, pixels: the size of the reference camera's images. */
const savedSize = () => [scene.lens.width, scene.lens.height];
const streams = panes.map(
  (pane, k) => new Stream("ab"[k], size, (picture) => shown(pane, picture), (sentence) => failed(pane, sentence)),
);
let isPlaying = false;
/** Whether the server did not answer the last request. */
let isLost = false;
let orbit = null;
let arrivals = [];

function toast(text) {
  const element = byId("toast");
  element.textContent = text;
  element.hidden = false;
  clearTimeout(toast.timer);
  toast.timer = setTimeout(() => (element.hidden = true), TOAST_MS);
}

function shown(pane, picture) {
  byId("waiting").hidden = true;
  pane.show(picture);
  isLost = false;
  if (pane === panes[0]) arrivals.push(performance.now());
  const method = pane === panes[0] ? state.left : state.right;
  if (method === legend.method) legend.shown(picture, state.query()).catch(() => {});
  describe();
}

function failed(pane, sentence) {
  byId("waiting").hidden = true;
  isLost = sentence === ENDED;
  const truth = state.nearestTruth();
  const isTruth = (pane === panes[0] ? state.left : state.right) === "truth";
  const action = isTruth && truth ? ["Go to the nearest", () => state.goTo(state.nearestTruth())] : null;
  pane.fail(sentence, action);
  describe();
}

/** Checks whether the server can be reached, if no other request is running. (A page at rest requests no pictures.) */
async function listenForHeart() {
  if (document.hidden || streams.some((stream) => stream.abort)) return;
  try {
    await fetch("icon.svg", { cache: "no-store", signal: AbortSignal.timeout(HEARTBEAT_MS) });
    if (isLost) request();
  } catch {
    panes.forEach((pane, k) => [state.left, state.right][k] && failed(pane, ENDED));
  }
}

/** Describes the methods by which a picture was rendered. `madeBy` has their names on the command line. */
const inWords = (madeBy) => madeBy.split(", ").map((name) => WORDS[name] ?? name).join(", ");

/** Shows the methods, the size and the frame rate of the pictures, beneath the capture's name. */
function describe() {
  const now = performance.now();
  arrivals = arrivals.filter((time) => now - time < 1000);
  const { picture } = panes[0];
  if (isLost) byId("status").textContent = "no connection to the server";
  if (!picture || isLost) return;
  const all = state.right ? panes : panes.slice(0, 1);
  const isQuick = all.some((pane) => pane.picture?.level !== "full");
  const how = [...new Set(all.map((pane) => pane.picture?.madeBy).filter(Boolean))].map(inWords).join(" | ");
  const isStill = !isPlaying && !orbit;
  const isAsking = changed.needsPicture || streams.some((stream) => stream.abort);
  const isWithout = all.some((pane) => !pane.problem.hidden);
  const isRefining = isStill && (isAsking || arrivals.length < 2);
  const rate = isWithout ? "no picture" : isStill && !isQuick && !isAsking ? "at rest" : isRefining ? "refining …" : `${arrivals.length} frames/s`;
  const pixels = Object.assign(document.createElement("span"), { textContent: ` · ${picture.width}×${picture.height}` });
  byId("status").replaceChildren(how || "as the simulator rendered it", pixels, ` · ${rate}`);
}

/** Requests pictures of the current state. */
function request() {
  const fields = state.query();
  const methods = [state.left, state.right];
  streams.forEach((stream, k) => {
    // The page has a list of the ground-truth images. For a view without one, no request is needed.
    if (methods[k] === "truth" && !state.isTrue()) {
      stream.want(null);
      failed(panes[k], scene.truths.length ? "There is truth at some places and times only" : "This capture has no truth");
    } else stream.want(methods[k] ? { ...fields, method: methods[k] } : null);
  });
}

const metres = (value) => `${value < 0 ? "−" : ""}${Math.abs(value * 100).toFixed(1)} cm`;

/** Shows the state in the controls. */
function reflect() {
  for (const axis of ["x", "y", "z"]) {
    byId(axis).value = state[axis];
    document.querySelector(`output[for=${axis}]`).value = metres(state[axis]);
    byId(axis).setAttribute("aria-valuetext", metres(state[axis]));
  }
  byId("zoom").value = Math.log2(state.zoom);
  byId("zoom").setAttribute("aria-valuetext", `${state.zoom.toFixed(2)} times`);
  document.querySelector("output[for=zoom]").value = `${state.zoom.toFixed(2)}×`;
  byId("at").value = state.at;
  byId("time").value = state.t;
  const frame = state.frame().toFixed(2);
  byId("time").setAttribute("aria-valuetext", `${state.t.toFixed(4)} seconds, frame ${frame}`);
  const small = Object.assign(document.createElement("small"), { textContent: ` frame ${frame}` });
  byId("clock").replaceChildren(`${state.t.toFixed(4)} s`, small);
  byId("left").value = state.left;
  byId("right").value = state.right;
  for (const name of ["sync", "proxy"]) byId(name).value = state[name] || scene.chosen[name];
  legend.of([state.left, state.right].find((method) => ["sources", "depth"].includes(method)) ?? "");
  byId("split").value = state.split;
  byId("divide").hidden = panes[1].element.hidden = !state.right;
  byId("line").style.left = `${state.split}%`;
  byId("label-a").textContent = METHODS[state.left];
  byId("label-b").textContent = METHODS[state.right] ?? "";
  panes[0].center(state.right ? state.split / 2 : 50);
  panes[1].center(50 + state.split / 2);
  panes[1].element.style.clipPath = `inset(0 0 0 ${state.split}%)`;
  panes[0].element.style.clipPath = state.right ? `inset(0 ${100 - state.split}% 0 0)` : "";
  map.draw();
  plan.draw();
}

let isDue = false;
let settling = 0;

/** Called after a change of the state. Updates controls and requests once per animation frame, and the link at rest. */
function changed(names) {
  if (!isDue) {
    isDue = true;
    requestAnimationFrame(() => {
      isDue = false;
      reflect();
      if (changed.needsPicture) request();
      changed.needsPicture = false;
    });
  }
  if (names.some((name) => name !== "split")) changed.needsPicture = true;
  describe();
  clearTimeout(settling);
  settling = setTimeout(() => {
    history.replaceState(null, "", `#${state.link()}`);
    describe();
  }, SETTLE_MS);
}

// Time

const speed = () => Number(byId("speed").value);

function play(on) {
  isPlaying = on && Boolean(scene.span_s);
  if (isPlaying) stopTime(false);
  press("play", isPlaying);
  byId("play").querySelector("use").setAttribute("href", isPlaying ? "#i-pause" : "#i-play");
  byId("play").setAttribute("aria-label", isPlaying ? "Pause" : "Play");
  run();
}

/** Starts or ends the orbit, in which time stands still while the viewpoint moves along the cameras. */
function stopTime(on) {
  orbit = on ? { since: performance.now(), path: orbitPath() } : null;
  if (on && isPlaying) play(false);
  press("orbit", on);
  run();
}

const press = (id, on) => byId(id).setAttribute("aria-pressed", String(on));

/**
 * The path of the orbit: a function from an angle, radians, to a viewpoint. The path goes along a line of cameras and
 * back. For cameras that fill a plane, it is an ellipse around their middle.
 */
function orbitPath() {
  const places = scene.cameras.map((camera) => camera.at).sort((a, b) => a[0] - b[0]);
  const extent = [0, 1].map((k) => [Math.min(...places.map((p) => p[k])), Math.max(...places.map((p) => p[k]))]);
  const [[left, right], [bottom, top]] = extent;
  const [half, mid] = [(right - left) / 2, [(left + right) / 2, (bottom + top) / 2]];
  if (top - bottom > 0.25 * (right - left)) {
    const high = (top - bottom) / 2;
    return (turn) => ({ x: mid[0] + half * Math.sin(turn), y: mid[1] + high * Math.cos(turn) });
  }
  return (turn) => {
    const x = mid[0] + half * Math.sin(turn);
    const after = Math.max(1, places.findIndex((p) => p[0] >= x));
    const [a, b] = [places[after - 1], places[after] ?? places[after - 1]];
    const share = b[0] > a[0] ? (x - a[0]) / (b[0] - a[0]) : 0;
    return { x, y: a[1] + (b[1] - a[1]) * share, z: a[2] + (b[2] - a[2]) * share };
  };
}

let last = null;

/** Advances the playback or the orbit by one animation frame. */
function step(now) {
  const passed = last === null ? 0 : Math.min(0.2, (now - last) / 1000);
  last = now;
  if (isPlaying) {
    const [first, end] = scene.span_s;
    const time = state.t + passed * speed();
    state.set({ t: time > end ? first + ((time - first) % (end - first)) : time });
  } else if (orbit) {
    state.set(orbit.path((2 * Math.PI * (now - orbit.since)) / 1000 / ORBIT_S));
  } else {
    last = null;
    return;
  }
  requestAnimationFrame(step);
}

function run() {
  if (last === null && (isPlaying || orbit)) requestAnimationFrame(step);
}

function toFrame(by) {
  play(false);
  const frame = state.frame();
  const next = Math.abs(by) < 1 ? frame + by : by > 0 ? Math.floor(frame + 1 + 1e-9) : Math.ceil(frame - 1 - 1e-9);
  state.set({ t: state.timeOf(next) });
}

// Keys

const MOVES = { ArrowLeft: ["x", -1], ArrowRight: ["x", 1], ArrowUp: ["y", 1], ArrowDown: ["y", -1], w: ["z", 1], s: ["z", -1] };
const TURNS = { ArrowLeft: ["yaw", -1], ArrowRight: ["yaw", 1], ArrowUp: ["pitch", 1], ArrowDown: ["pitch", -1] };

function faster(by) {
  const select = byId("speed");
  select.selectedIndex = Math.min(select.length - 1, Math.max(0, select.selectedIndex - by));
}

const beside = (method) => state.set({ right: state.right ? "" : method });

const KEYS = {
  " ": () => play(!isPlaying),
  ",": () => toFrame(-1),
  ".": () => toFrame(1),
  "<": () => toFrame(-0.1),
  ">": () => toFrame(0.1),
  "[": () => faster(-1),
  "]": () => faster(1),
  t: () => stopTime(!orbit),
  "+": () => state.set({ zoom: state.zoom * 1.1 }),
  "=": () => state.set({ zoom: state.zoom * 1.1 }),
  "-": () => state.set({ zoom: state.zoom / 1.1 }),
  Home: () => state.set(state.home),
  1: () => state.set({ left: "st" }),
  2: () => state.set({ left: "lfr" }),
  3: () => truthAt("left"),
  4: () => state.set({ left: "sources" }),
  5: () => state.set({ left: "depth" }),
  c: () => beside(state.left === "lfr" ? "st" : "lfr"),
  n: () => state.goTo(state.nearestTruth()),
  m: () => toggleMap(),
  l: () => copyLink(),
  p: () => save(() => savePicture(state, savedSize(), state.left)),
  "?": () => byId("keys").showModal(),
};

/** Whether the focused control uses the key: arrows move a slider, space presses a button, letters select in a list. */
function isTaken({ key, target }) {
  if (target.closest("dialog, #save-menu")) return true;
  if (target.matches("select")) return /^[\p{L}\p{N} ]$/u.test(key) || key.startsWith("Arrow") || key === "Home";
  if (target.matches("input")) return key.startsWith("Arrow") || key === "Home";
  return target.matches("button") && key === " ";
}

function key(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || isTaken(event)) return;
  const name = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  const [axis, way] = (event.shiftKey ? TURNS : MOVES)[name] ?? [];
  if (axis && (name.length > 1 || !event.shiftKey)) {
    const step = axis in { yaw: 0, pitch: 0 } ? 1 / state.zoom : (scene.high[0] - scene.low[0]) / 80;
    stopTime(false);
    state.set({ [axis]: state[axis] + way * step });
  } else if (KEYS[name]) KEYS[name]();
  else return;
  event.preventDefault();
}

// Controls

/** Shows the ground truth on one side. If the current view has none, moves to the nearest ground-truth image. */
function truthAt(side) {
  if (!state.isTrue() && scene.truths.length) state.goTo(state.nearestTruth());
  play(false);
  stopTime(false);
  state.set({ [side]: "truth" });
}

function toggleMap() {
  const isOpen = byId("place").classList.toggle("open");
  byId("map-button").setAttribute("aria-expanded", String(isOpen));
  map.draw();
  plan.draw();
}

async function copyLink() {
  history.replaceState(null, "", `#${state.link()}`);
  const isCopied = await copy(location.href);
  const until = "It works until the server ends; Save has the command that opens this place later.";
  toast(isCopied ? `The link to this place is copied. ${until}` : `The address of this page is the link to this place. ${until}`);
}

async function save(action) {
  byId("save-menu").hidePopover();
  try {
    await action();
    toast("Saved among the downloads.");
  } catch (error) {
    toast(`Not saved: ${error.message}`);
  }
}

function option(select, value, text) {
  select.append(Object.assign(document.createElement("option"), { value, textContent: text }));
}

function fill() {
  for (const [name, title] of Object.entries(METHODS)) {
    if (name === "truth" && !scene.truths.length) continue;
    option(byId("left"), name, title);
  }
  option(byId("right"), "", "nothing");
  for (const { value, textContent } of [...byId("left").options]) option(byId("right"), value, textContent);
  option(byId("at"), "", "anywhere");
  const group = (label) => byId("at").appendChild(Object.assign(document.createElement("optgroup"), { label }));
  const [cameras, truths] = [group("Cameras"), scene.truths.length ? group("Places and instants with truth") : null];
  scene.cameras.forEach(({ id }, k) => option(cameras, `c${k}`, id));
  scene.truths.forEach((truth, k) => option(truths, `t${k}`, truthName(truth)));
  for (const name of ["sync", "proxy"]) {
    for (const method of scene.methods[name]) option(byId(name), method.name, WORDS[method.name] ?? method.name);
  }
  for (const key of document.querySelectorAll(".of-truth")) key.hidden = !scene.truths.length;
  document.documentElement.style.setProperty("--ratio", scene.lens.width / scene.lens.height);
  ["x", "y", "z"].forEach((axis, k) => Object.assign(byId(axis), { min: scene.low[k], max: scene.high[k] }));
  const [least, largest] = scene.zooms.map(Math.log2);
  Object.assign(byId("zoom"), { min: least, max: largest });
  byId("time-row").hidden = !scene.span_s;
  if (scene.span_s) fillTime(scene.span_s);
  byId("name").textContent = document.title = scene.name;
  document.title += " · stlfr";
}

function fillTime([first, last]) {
  Object.assign(byId("time"), { min: first, max: last });
  const mark = (time, name) => {
    if (time < first || time > last) return;
    const tick = byId("ticks").appendChild(document.createElement("i"));
    tick.className = name;
    tick.style.left = `${(100 * (time - first)) / (last - first)}%`;
  };
  if (scene.frames_s.length <= 200) scene.frames_s.forEach((time) => mark(time, ""));
  new Set(scene.truths.map((truth) => truth.time_s)).forEach((time) => mark(time, "truth"));
  const speeds = [...byId("speed").options];
  byId("speed").value = (speeds.find(({ value }) => (last - first) / Number(value) >= MIN_LOOP_S) ?? speeds.at(-1)).value;
}

/** Shows the blending weights or the depth under the pointer in the legend. */
function pointAt({ clientX, clientY }) {
  const box = byId("picture").getBoundingClientRect();
  const place = [(clientX - box.left) / box.width, (clientY - box.top) / box.height];
  const isInside = place.every((v) => v >= 0 && v < 1);
  legend.point(isInside ? place : null, state.left === legend.method ? panes[0] : panes[1]);
}

function listen() {
  gestures(byId("stage"), byId("picture"), state);
  byId("stage").addEventListener("pointermove", pointAt);
  byId("stage").addEventListener("pointerleave", () => legend.point(null));
  byId("stage").addEventListener("pointerdown", () => stopTime(false));
  for (const axis of ["x", "y", "z"]) byId(axis).addEventListener("input", () => state.set({ [axis]: byId(axis).valueAsNumber }));
  byId("zoom").addEventListener("input", () => state.set({ zoom: 2 ** byId("zoom").valueAsNumber }));
  byId("time").addEventListener("input", () => {
    play(false);
    state.set({ t: byId("time").valueAsNumber });
  });
  byId("split").addEventListener("input", () => state.set({ split: byId("split").valueAsNumber }));
  byId("at").addEventListener("change", () => (byId("at").value ? state.goTo(byId("at").value) : state.set({ x: state.x })));
  for (const side of ["left", "right"]) {
    byId(side).addEventListener("change", () => (byId(side).value === "truth" ? truthAt(side) : state.set({ [side]: byId(side).value })));
  }
  for (const name of ["sync", "proxy"]) {
    byId(name).addEventListener("change", () => state.set({ [name]: byId(name).value === scene.chosen[name] ? "" : byId(name).value }));
  }
  byId("play").addEventListener("click", () => play(!isPlaying));
  byId("orbit").addEventListener("click", () => stopTime(!orbit));
  byId("map-button").addEventListener("click", toggleMap);
  byId("link").addEventListener("click", copyLink);
  byId("help").addEventListener("click", () => byId("keys").showModal());
  byId("save-menu").addEventListener("toggle", () => {
    byId("command").textContent = command(state);
    byId("return").textContent = returnCommand(state);
    const isSame = ["st", "lfr"].includes(state.left);
    byId("command-title").textContent = isSame ? "In a terminal, the same picture:" : "In a terminal, the same view by ST-LFR:";
  });
  byId("save-png").addEventListener("click", () => save(() => savePicture(state, savedSize(), state.left)));
  byId("save-json").addEventListener("click", () => save(() => saveCamera(state, savedSize())));
  for (const [id, text] of [["copy-command", command], ["copy-return", returnCommand]]) {
    byId(id).addEventListener("click", async () => toast((await copy(text(state))) ? "Copied." : "Not copied: mark it by hand."));
  }
  document.addEventListener("keydown", key);
  new ResizeObserver(() => changed(["size"])).observe(byId("picture"));
  // The page may have replaced the link before this event arrives, so that its target is read from the event.
  addEventListener("hashchange", (event) => state.follow(new URL(event.newURL).hash.slice(1)));
  setInterval(describe, SETTLE_MS);
  setInterval(listenForHeart, HEARTBEAT_MS);
}

async function start() {
  const response = await fetch("scene.json", { cache: "no-store" });
  if (!response.ok) throw new Error(await response.text());
  scene = await response.json();
  state = new State(scene, (names) => changed(names));
  map = new RigMap(byId("map"), state);
  plan = new Plan(byId("plan"), state);
  legend = new Legend(byId("legend"), scene);
  fill();
  listen();
  state.follow(location.hash.slice(1));
  changed(["start"]);
}

start().catch((error) => {
  byId("waiting").textContent = error instanceof TypeError ? ENDED : error.message;
});

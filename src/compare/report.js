"use strict";
// The viewer: two pictures of one view with a border between them, and the same small crop of every method's picture.

const byId = (id) => document.getElementById(id);
const groups = JSON.parse(byId("pictures").textContent);
const views = groups.flatMap((group) => group.views.map((view) => ({ ...view, group })));
const TRUTH = "truth";
/** The PSNRs at which a bar beneath a crop is empty and full, decibels. */
const METER_DB = [15, 45];

const number = (value, digits) => (value === null || value === undefined ? "–" : value.toFixed(digits).replace("-", "−"));
const psnr = (scores) => (scores.psnr_db === null && scores.pixels > 0 ? "identical" : `${number(scores.psnr_db, 1)} dB`);
/** The part of the image whose scores the picker shows: the moving part, or the whole image if nothing moves. */
const part = (scores) => (scores.moving.pixels > 0 ? "moving" : "whole");

/** The viewer's state. `left` and `right` are "truth", or the row and the column of a picture, such as "1,2". */
const state = { view: 0, left: TRUTH, right: "", differs: false, gain: 4, at: 50, place: [0.5, 0.5], zoom: 8 };

const view = () => views[state.view];
function cellOf(key) {
  const [row, column] = key.split(",").map(Number);
  return view().cells[row][column];
}
const fileOf = (key) => (key === TRUTH ? view().truth : cellOf(key).file);
function labelOf(key) {
  if (key === TRUTH) return "Truth";
  const [row, column] = key.split(",").map(Number);
  const { rows, columns } = view().group;
  return [columns[column], rows[row]].filter(Boolean).join(", ");
}
const keys = () => view().cells.flatMap((row, r) => row.map((_, c) => `${r},${c}`));

function element(name, properties, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

/** Selects a view. If it lacks the picture shown at the right, its first picture is shown; at the left, the truth. */
function select(index) {
  const before = view().group;
  state.view = index;
  const { group, focus, cells, size_px: [width, height] } = view();
  state.place = focus;
  if (group !== before || !state.right) {
    [state.left, state.right] = [`${group.start[0]},0`, group.start.join()];
  }
  const available = keys().filter((key) => cellOf(key).file);
  if (state.right !== TRUTH && !available.includes(state.right)) state.right = available[0] ?? TRUTH;
  if (state.left !== TRUTH && !available.includes(state.left)) state.left = TRUTH;
  byId("left").replaceChildren(...[TRUTH, ...available].map((key) => new Option(labelOf(key), key)));
  byId("stage").style.aspectRatio = `${width} / ${height}`;
  byId("stage").style.maxWidth = `calc(86vh * ${width / height})`;
  fillPicker(cells, width / height);
  draw();
}

/** Makes the picker: buttons for the truth and for each picture, with a row per proxy and a column per method. */
function fillPicker(cells, ratio) {
  const { rows, columns } = view().group;
  const named = rows.some(Boolean);
  const picker = byId("picker");
  const narrow = matchMedia("(max-width: 640px)").matches;
  picker.style.gridTemplateColumns = `${named && !narrow ? "minmax(52px, auto) " : ""}repeat(${Math.max(columns.length, 3)}, minmax(0, 1fr))`;
  const corner = () => element("span", { className: "corner" });
  const crop = () => {
    const made = element("span", { className: "crop" });
    made.style.aspectRatio = String(ratio);
    return made;
  };
  const note = element("p", { className: "note", textContent: "Every crop shows the place in the frame. Point at the picture, or use its arrow keys, to move the frame. A crop that is chosen is shown on the right." });
  note.style.gridColumn = named && !narrow ? "3 / -1" : "2 / -1";
  const truth = element("button", { type: "button" }, crop(), element("span", { className: "value", textContent: "Truth" }));
  truth.dataset.key = TRUTH;
  picker.replaceChildren(...(named ? [corner()] : []), truth, note);
  if (named) picker.append(corner());
  picker.append(...columns.map((title) => element("span", { className: "head", textContent: title })));
  for (let k = columns.length; k < 3; k++) picker.append(element("span"));
  cells.forEach((row, r) => {
    if (named) picker.append(element("span", { className: "row", textContent: rows[r] }));
    row.forEach((cell, c) => picker.append(button(cell, `${r},${c}`, crop())));
  });
}

function button(cell, key, crop) {
  if (!cell.file) return element("span", { className: "missing", textContent: "no image", title: cell.reason ?? "" });
  const made = element("button", { type: "button" }, crop);
  made.dataset.key = key;
  if (cell.scores) {
    const scores = cell.scores[part(cell.scores)];
    const meter = element("span", { className: "meter" });
    const share = (scores.psnr_db ?? METER_DB[1]) - METER_DB[0];
    meter.style.setProperty("--share", `${Math.min(100, Math.max(2, (100 * share) / (METER_DB[1] - METER_DB[0])))}%`);
    made.append(element("span", { className: "value", textContent: psnr(scores) }), meter);
    made.setAttribute("aria-label", `${labelOf(key)}: ${psnr(scores)}, ${part(cell.scores)} part`.replace("whole part", "whole image"));
  }
  return made;
}

/** Updates the page to show the current state. */
function draw() {
  const { differs, gain, at } = state;
  const stage = byId("stage");
  const isAlone = state.left === state.right || (differs && state.left === TRUTH);
  stage.classList.toggle("differs", differs);
  byId("gain-label").hidden = !differs;
  for (const [side, key] of [["a", state.left], ["b", state.right]]) {
    const [picture, truth] = byId(side).children;
    show(picture, fileOf(key), labelOf(key));
    if (differs) show(truth, view().truth, "");
    byId(side).style.filter = differs ? `brightness(${gain})` : "";
  }
  byId("a").hidden = byId("rule").hidden = isAlone;
  byId("a").style.clipPath = `inset(0 ${100 - at}% 0 0)`;
  byId("rule").style.left = `${at}%`;
  byId("rule").setAttribute("aria-valuenow", String(Math.round(at)));
  const tag = (key) => (differs && key !== TRUTH ? `${labelOf(key)}: difference × ${gain}` : labelOf(key));
  byId("tag-a").textContent = tag(state.left);
  byId("tag-a").hidden = isAlone;
  byId("tag-b").textContent = tag(state.right);
  byId("left").value = state.left;
  byId("under").replaceChildren(...[...new Set([state.left, state.right])].filter((key) => key !== TRUTH).map(described));
  drawLoupe();
}

/** Sets the file and the label of an image element. A file that is shown already is not loaded again. */
function show(image, file, label) {
  if (image.getAttribute("src") !== file) image.src = file;
  image.alt = label;
}

function described(key) {
  const { scores } = cellOf(key);
  const of = (region) => `${psnr(region)}, SSIM ${number(region.ssim, 3)}, FLIP ${number(region.flip, 3)}`;
  const text = scores ? `moving part ${of(scores.moving)}; whole image ${of(scores.whole)}` : "not measured";
  return element("span", { textContent: `${labelOf(key)}: ${text}` });
}

/** Moves the loupe's frame, and the crops to the part of the picture that is inside the frame. */
function drawLoupe() {
  const { place, zoom, differs, gain } = state;
  const size = 1 / zoom;
  const corner = place.map((v) => Math.min(1 - size, Math.max(0, v - size / 2)));
  Object.assign(byId("frame").style, { left: `${100 * corner[0]}%`, top: `${100 * corner[1]}%`, width: `${100 * size}%`, height: `${100 * size}%` });
  byId("frame").hidden = zoom === 1;
  const shift = corner.map((v) => (zoom === 1 ? 0 : (100 * v) / (1 - size)));
  for (const made of byId("picker").querySelectorAll("button")) {
    const crop = made.firstElementChild;
    const hasDifference = differs && made.dataset.key !== TRUTH;
    const files = [fileOf(made.dataset.key), ...(hasDifference ? [view().truth] : [])].map((file) => `url("${encodeURI(file)}")`);
    const image = files.join(", ");
    // Assigning the same image again would make the browser load it again.
    if (crop.dataset.image !== image) crop.style.backgroundImage = crop.dataset.image = image;
    Object.assign(crop.style, {
      backgroundSize: `${100 * zoom}% ${100 * zoom}%`,
      backgroundPosition: `${shift[0]}% ${shift[1]}%`,
      backgroundBlendMode: hasDifference ? "difference, normal" : "normal",
      filter: hasDifference ? `brightness(${gain})` : "",
    });
    made.setAttribute("aria-pressed", String(made.dataset.key === state.right));
  }
}

function change(values) {
  Object.assign(state, values);
  draw();
}

const clamp = (value, most) => Math.min(most, Math.max(0, value));
/** The pointer's position on the stage, as fractions of the stage's width and height. */
function placeOf(event) {
  const box = byId("stage").getBoundingClientRect();
  return [clamp((event.clientX - box.left) / box.width, 1), clamp((event.clientY - box.top) / box.height, 1)];
}

const STEPS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

function listen() {
  const [stage, rule] = [byId("stage"), byId("rule")];
  rule.addEventListener("pointerdown", (event) => {
    rule.setPointerCapture(event.pointerId);
    event.stopPropagation();
  });
  rule.addEventListener("pointermove", (event) => {
    if (!rule.hasPointerCapture(event.pointerId)) return;
    event.stopPropagation();
    change({ at: 100 * placeOf(event)[0] });
  });
  rule.addEventListener("keydown", (event) => {
    const step = STEPS[event.key];
    if (!step) return;
    event.preventDefault();
    event.stopPropagation();
    change({ at: clamp(state.at + 2 * (step[0] - step[1]), 100) });
  });
  const moveLoupe = (event) => {
    state.place = placeOf(event);
    drawLoupe();
  };
  stage.addEventListener("pointerdown", moveLoupe);
  stage.addEventListener("pointermove", (event) => {
    if (event.pointerType === "mouse" || event.buttons) moveLoupe(event);
  });
  stage.addEventListener("keydown", (event) => {
    const step = STEPS[event.key];
    if (!step) return;
    event.preventDefault();
    state.place = state.place.map((v, k) => clamp(v + step[k] / 40, 1));
    drawLoupe();
  });
  byId("picker").addEventListener("click", (event) => {
    const { key } = event.target.closest("button")?.dataset ?? {};
    if (key) change({ right: key });
  });
  byId("view").addEventListener("change", () => select(Number(byId("view").value)));
  byId("left").addEventListener("change", () => change({ left: byId("left").value }));
  byId("gain").addEventListener("change", () => change({ gain: Number(byId("gain").value) }));
  byId("zoom").addEventListener("change", () => change({ zoom: Number(byId("zoom").value) }));
  for (const mode of document.querySelectorAll("input[name=mode]")) {
    mode.addEventListener("change", () => change({ differs: byId("differs").checked }));
  }
  matchMedia("(max-width: 640px)").addEventListener("change", () => select(state.view));
  for (const image of stage.querySelectorAll("img")) {
    image.addEventListener("error", () => (byId("under").textContent = `${image.getAttribute("src")} can’t be read: this file belongs beside the folder images.`));
  }
}

if (views.length) {
  let index = 0;
  for (const group of groups) {
    const titles = group.views.map(({ title }) => new Option(title, index++));
    byId("view").append(element("optgroup", { label: group.title }, ...titles));
  }
  byId("viewer").hidden = false;
  listen();
  select(0);
}

// A collapsed part of the report is opened if a link leads to it. All parts are opened for printing.
const unfold = () => document.querySelector(`details[id="${CSS.escape(location.hash.slice(1))}"]`)?.setAttribute("open", "");
addEventListener("hashchange", unfold);
addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((part) => (part.open = true)));
unfold();

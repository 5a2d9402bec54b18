// Strip charts, spectra and the waterfall: what has come from the server, drawn.

import { Ring, Scale, extent, fixed, number, rounded, strip, wipe } from "./charts.js";
import { $, element } from "./dom.js";
import { clockTime, counters, factorOf, page, unitOf } from "./shown.js";
import { colourScale, spectrum, waterfall } from "./spectra.js";

const STEP = 10; // bins of a level in one of the next
const PERIODS = 5; // natural frequencies that a spectrum shows
const ROWS = 120; // spectra in the waterfall
const HELD = [15, 3, 2]; // how often what the server keeps of a level is kept here: one minute, five, twenty
const FINEST = 20; // bins that a window shows at least
const STAMPED = 500; // time from one pair of tick and clock to the next [ms]

// What is looked at. Live: `end` is null. Else what was there at the pause is held, and `end` is a tick of it.
export const view = { level: 1, seconds: 10, end: null, cursor: null, selection: null, locked: false };

let rings = [],
  held = null,
  heldTick = 0,
  scales = new Map(),
  stamps = [],
  rows = [],
  largest = 0,
  newestTick = 0,
  dirty = false,
  due = false;

export function beginCharts() {
  makeRings();
  held = view.end = view.cursor = view.selection = null;
  view.seconds = Number($("window").value);
  scales.clear();
  stamps = [];
  newestTick = 0;
  const forces = page.panel.components.length > 0;
  for (const id of ["no-force", "no-spectrum"]) $(id).hidden = forces;
  $("spectra-shown").hidden = !forces;
  $("channels").replaceChildren(
    ...page.panel.names.map((name, place) =>
      element(
        "div",
        { class: "channel" },
        element(
          "p",
          {},
          element("b", {}, name),
          element("span", { id: `at-${place}`, class: "u" }),
          element("span", { id: `value-${place}` }),
          element("span", { class: "u" }, unitOf(place)),
        ),
        element("canvas", { id: `channel-${place}`, role: "img", "aria-label": `Strip chart of ${name}` }),
      ),
    ),
  );
  forgetSpectra();
}

function makeRings() {
  const { kept, names, components } = page.panel,
    size = kept[view.level] * HELD[view.level];
  rings = [new Ring(size, names.length), ...components.map(() => new Ring(size, 2))];
}

// Say how long a window is shown; whether other bins are needed for it. Where it is looked back, what is held is shown.
export function chooseWindow(seconds) {
  if (held) {
    look(view.end, seconds);
    return false;
  }
  view.seconds = seconds;
  const wish = seconds <= 2 ? 0 : seconds <= 60 ? 1 : 2,
    other = wish !== view.level;
  if (!view.locked) scales.clear();
  view.level = wish;
  if (other && page.panel) makeRings();
  redraw();
  return other;
}

export const looksBack = () => held !== null;

// Hold what is there now, to be looked into.
export function hold() {
  if (held || !page.panel) return;
  held = rings.map((ring) => ring.copy());
  heldTick = view.end = newestTick;
  later(); // nothing new that comes has it drawn: "Paused at ..." and the time axis
}

export function live() {
  held = view.end = view.selection = null;
  redraw();
}

// Show another part of what is held: up to a tick, and how long.
export function look(end, seconds) {
  hold();
  if (!held) return;
  const { rate } = page.panel,
    first = held[0].first * ticksOfBin(),
    longest = Math.max((heldTick - first) / rate, (FINEST * ticksOfBin()) / rate);
  view.seconds = Math.min(Math.max(seconds, (FINEST * ticksOfBin()) / rate), longest);
  view.end = Math.min(Math.max(end, first + view.seconds * rate), heldTick);
  redraw();
}

// Zoom by a factor about a part of the width, or scroll by a part of it.
export function zoom(factor, about = 0.5) {
  hold();
  if (!held) return;
  const span = view.seconds * page.panel.rate,
    at = view.end - (1 - about) * span;
  look(at + (1 - about) * span * factor, view.seconds * factor);
}

export function scroll(part) {
  hold();
  if (held) look(view.end + part * view.seconds * page.panel.rate, view.seconds);
}

export function select([from, to]) {
  hold();
  if (!held) return;
  const span = view.seconds * page.panel.rate;
  look(view.end - (1 - to) * span, view.seconds * (to - from));
}

export function lock(locked) {
  view.locked = locked;
  for (const [name, scale] of scales) scale.locked = locked && name.startsWith("main ");
}

export function forgetSpectra() {
  rows = [];
  for (const id of ["spectrum", "waterfall", "colour-scale"]) wipe($(id));
  redraw();
}

export function later() {
  dirty = true;
  if (due) return;
  due = true;
  requestAnimationFrame(() => {
    due = false;
    draw();
  });
}

export function redraw() {
  dirty = true;
  draw();
  drawSpectra();
}

const ticksOfBin = () => page.panel.width * STEP ** view.level;

// When a sample came, by the server's clock [ms]; null where that is not known.
export function timeAt(tick) {
  if (!stamps.length) return null;
  let low = 0,
    high = stamps.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (stamps[middle].tick <= tick) low = middle;
    else high = middle - 1;
  }
  const from = stamps[low],
    to = stamps[low + 1];
  if (!to || tick < from.tick) return from.ms + ((tick - from.tick) / page.panel.rate) * 1e3;
  return from.ms + ((to.ms - from.ms) * (tick - from.tick)) / (to.tick - from.tick);
}

function stamp(tick, ms) {
  const last = stamps.at(-1);
  if (last && ms - last.ms < STAMPED) return;
  stamps.push({ tick, ms });
  if (stamps.length > 5000) stamps.shift();
}

// A frame of spectra; false where it is of another source or component.
export function takeSpectra(frame, buffer) {
  const place = frame.getUint8(1),
    count = frame.getUint16(2, true),
    source = frame.getUint32(8, true);
  if (!page.panel || source !== page.panel.number || page.panel.components[place] !== page.component) return;
  largest = frame.getFloat32(12, true);
  const lines = frame.getUint32(16, true),
    data = new Float32Array(buffer.slice(20));
  for (let k = 0; k < count; k++) rows.push(data.subarray(k * lines * 2, (k + 1) * lines * 2));
  rows = rows.slice(-ROWS);
  requestAnimationFrame(drawSpectra);
}

export function takeBins(frame, buffer) {
  const level = frame.getUint8(1),
    groups = frame.getUint8(2),
    source = frame.getUint32(8, true);
  if (!page.panel || source !== page.panel.number || level !== view.level) return;
  let at = 40;
  for (let k = 0; k < groups; k++) {
    const place = frame.getUint8(at),
      columns = frame.getUint8(at + 1),
      count = frame.getUint32(at + 4, true),
      first = frame.getFloat64(at + 8, true);
    const values = new Float32Array(buffer, at + 16, count * columns * 2);
    if (place === 0) inDegrees(values);
    rings[place]?.put(first, count, values);
    at += 16 + count * columns * 8;
  }
  newestTick = frame.getFloat64(32, true);
  stamp(newestTick, frame.getFloat64(16, true));
  if (!held) dirty = true;
}

function inDegrees(values) {
  const width = 2 * page.panel.names.length;
  page.panel.units.forEach((unit, column) => {
    if (unit !== "rad") return;
    for (let at = 2 * column; at < values.length; at += width) {
      values[at] *= factorOf(column);
      values[at + 1] *= factorOf(column);
    }
  });
}

function scaleOf(name) {
  if (!scales.has(name)) {
    scales.set(name, new Scale());
    lock(view.locked);
  }
  return scales.get(name);
}

function limitsOf(name) {
  const { panel } = page,
    factor = factorOf(panel.names.indexOf(name)),
    half = panel.half_ranges[name];
  if (panel.limits[name]) return panel.limits[name].filter((value) => value !== null).map((value) => value * factor);
  return half ? [-half, half] : [];
}

// What the main chart's lines run between over the window: a peak stays there to be read after the numbers have gone on.
function showExtents(lines, begin, end, unit) {
  ["felt", "force"].forEach((line, k) => {
    const found = lines[k] && extent(lines[k], begin, end);
    counters.shown[line] = found ? { least: found[0], largest: found[1] } : null;
    const spread = found ? found[1] - found[0] : 0;
    $(`${line}-extent`).textContent = found
      ? `${rounded(found[0], spread)} to ${rounded(found[1], spread)} ${unit}`
      : "";
  });
}

// What is read at the cursor: the bins of a pixel, least and largest value where these differ.
function showCursor(lines, { end, rate, seconds, width, newest, unit }) {
  const at = view.cursor;
  counters.cursor = null;
  $("cursor-line").hidden = at === null;
  if (at === null) {
    page.panel.names.forEach((_, place) => ($(`at-${place}`).textContent = ""));
    return;
  }
  const bin = end - (1 - at) * seconds * rate,
    bins = Math.max(1, (seconds * rate) / width),
    ms = timeAt(bin * ticksOfBin()),
    back = (newest - bin) / rate;
  const read = (line, spread) => {
    const found = extent(line, Math.round(bin), Math.round(bin) + Math.ceil(bins));
    if (!found) return null;
    const [least, most] = found.map((value) => rounded(value, spread));
    return { least: found[0], largest: found[1], text: least === most ? least : `${least} to ${most}` };
  };
  const spreads = lines.map((line) => {
    const found = extent(line, end - seconds * rate, end);
    return found ? found[1] - found[0] : 0;
  });
  const [felt, force] = lines.map((line, k) => read(line, spreads[k]));
  const band = lines[1] && extent({ ...lines[1], column: 1 }, Math.round(bin), Math.round(bin) + Math.ceil(bins));
  const parts = [`${ms === null ? "" : clockTime(ms, 3)} (−${number(Math.max(0, back), 3)} s)`];
  parts.push(felt ? `balance load ${felt.text} ${unit}` : "no reading");
  if (force) parts.push(`force ${force.text}${band ? ` ± ${fixed(band[1], placesOf(band[1]))}` : ""} ${unit}`);
  else if (lines[1]) parts.push("force not yet worked out");
  const text = parts.join("; ");
  if ($("cursor-line").textContent !== text) $("cursor-line").textContent = text;
  counters.cursor = { ms, back, felt, force };
  page.panel.names.forEach((_, column) => {
    const found = read({ ring: lines[0].ring, column }, 0);
    $(`at-${column}`).textContent = found ? `at the cursor ${number(found.least)}` : "";
  });
}

const placesOf = (u) => Math.max(0, Math.min(4, 1 - Math.floor(Math.log10(u || 1))));

function showWindow(begin, end, newest, rate) {
  const line = $("look-line");
  line.hidden = !held;
  if (!held) return;
  const [from, to, paused] = [begin, end, newest].map((bin) => timeAt(bin * ticksOfBin()));
  if (from === null) return;
  const places = end - begin < 5 * rate ? 2 : 1;
  line.textContent = `Paused at ${clockTime(paused)}: ${clockTime(from, places)} to ${clockTime(to, places)} is shown`;
}

export function draw() {
  const { panel } = page;
  if (!panel || !dirty || document.hidden) return;
  dirty = false;
  const shown = held ?? rings,
    rate = panel.rate / ticksOfBin(),
    now = performance.now(),
    newest = (held ? heldTick : newestTick) / ticksOfBin(),
    end = (view.end ?? newestTick) / ticksOfBin(),
    { seconds } = view,
    begin = end - seconds * rate;
  const marks = page.marks
    .map(({ tick, kind, text }) => ({ bin: tick / ticksOfBin(), kind, text }))
    .filter((mark) => mark.bin > begin && mark.bin <= end);
  const places = seconds < 2 ? 2 : seconds < 10 ? 1 : 0,
    clock = (bin) => {
      const ms = timeAt(bin * ticksOfBin());
      return ms === null ? "" : clockTime(ms, places);
    };
  const { cursor, selection } = view,
    last = held ? "pause" : page.stale ? "newest" : "now",
    all = { end, rate, seconds, now, marks, zero: newest, last, clock, cursor, selection };
  const name = page.component || panel.names[0],
    place = panel.names.indexOf(name),
    force = panel.components.indexOf(page.component) + 1;
  const lines = [{ ring: shown[0], column: place, colour: "raw", width: 1 }];
  if (force > 0) lines.push({ ring: shown[force], column: 0, colour: "force", width: 2.2, band: true });
  const scale = scaleOf(`main ${name}`);
  strip($("main-chart"), scale, { ...all, lines, limits: limitsOf(name), unit: unitOf(place) });
  counters.scale = { low: scale.low, high: scale.high };
  showExtents(lines, begin, end, unitOf(place));
  showWindow(begin, end, newest, rate);
  showCursor(lines, { ...all, newest, width: $("main-chart").clientWidth - 70, unit: unitOf(place) });
  panel.names.forEach((channel, column) => {
    const canvas = $(`channel-${column}`),
      box = canvas.getBoundingClientRect();
    if (box.bottom < 0 || box.top > innerHeight) return;
    strip(canvas, scaleOf(channel), {
      ...all,
      lines: [{ ring: shown[0], column, colour: "raw", width: 1 }],
      axes: false,
      limits: limitsOf(channel),
    });
  });
}

export function drawSpectra() {
  const { panel, component } = page;
  if (!panel || held || !rows.length) return;
  const lines = rows[0].length / 2,
    natural = panel.frequencies[component];
  const shown = natural ? Math.min(lines, Math.ceil((lines * PERIODS * natural) / largest)) : lines;
  spectrum(
    $("spectrum"),
    rows[rows.length - 1],
    shown,
    (largest * shown) / lines,
    natural ? [natural] : [],
    unitOf(panel.names.indexOf(component)),
  );
  const range = waterfall($("waterfall"), rows, shown, Number($("waterfall-of").value));
  colourScale($("colour-scale"), range, unitOf(panel.names.indexOf(component)));
}

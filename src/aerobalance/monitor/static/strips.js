// Strip charts, spectra and the waterfall: what has come from the server, drawn.

import { Ring, Scale, extent, rounded, spectrum, strip, waterfall, wipe } from "./charts.js";
import { $, element } from "./dom.js";
import { counters, factorOf, page, unitOf } from "./shown.js";

const STEP = 10; // bins of a level in one of the next
const PERIODS = 5; // natural frequencies that a spectrum shows
const ROWS = 120; // spectra in the waterfall

export const view = { level: 1, seconds: 10, paused: false };

let rings = [],
  scales = new Map(),
  rows = [],
  largest = 0,
  newestTick = 0,
  frozen = 0,
  dirty = false;

export function beginCharts() {
  makeRings();
  scales.clear();
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
  const { kept, names, components } = page.panel;
  rings = [new Ring(kept[view.level], names.length), ...components.map(() => new Ring(kept[view.level], 2))];
}

export function chooseWindow(seconds) {
  view.seconds = seconds;
  const wish = seconds <= 2 ? 0 : seconds <= 60 ? 1 : 2,
    other = wish !== view.level;
  scales.clear();
  view.level = wish;
  if (other && page.panel) makeRings();
  redraw();
  return other;
}

export function forgetSpectra() {
  rows = [];
  for (const id of ["spectrum", "waterfall"]) wipe($(id));
  redraw();
}

export function pause(paused) {
  view.paused = paused;
  if (page.panel) frozen = newestBin();
}

export function redraw() {
  dirty = true;
  draw();
  drawSpectra();
}

const ticksOfBin = () => page.panel.width * STEP ** view.level;
const newestBin = () => newestTick / ticksOfBin();

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
  dirty = true;
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
  if (!scales.has(name)) scales.set(name, new Scale());
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

export function draw() {
  const { panel } = page;
  if (!panel || !dirty || document.hidden) return;
  dirty = false;
  const rate = panel.rate / ticksOfBin(),
    now = performance.now(),
    end = view.paused ? frozen : newestBin(),
    begin = end - view.seconds * rate;
  const marks = page.marks
    .map(({ tick, kind, text }) => ({ bin: tick / ticksOfBin(), kind, text }))
    .filter((mark) => mark.bin > begin && mark.bin <= end);
  const all = { end, rate, seconds: view.seconds, now, marks };
  const name = page.component || panel.names[0],
    place = panel.names.indexOf(name),
    force = panel.components.indexOf(page.component) + 1;
  const lines = [{ ring: rings[0], column: place, colour: "raw", width: 1 }];
  if (force > 0) lines.push({ ring: rings[force], column: 0, colour: "force", width: 2.2, band: true });
  strip($("main-chart"), scaleOf(`main ${name}`), { ...all, lines, limits: limitsOf(name), unit: unitOf(place) });
  showExtents(lines, begin, end, unitOf(place));
  panel.names.forEach((channel, column) => {
    const canvas = $(`channel-${column}`),
      box = canvas.getBoundingClientRect();
    if (box.bottom < 0 || box.top > innerHeight) return;
    strip(canvas, scaleOf(channel), {
      ...all,
      lines: [{ ring: rings[0], column, colour: "raw", width: 1 }],
      axes: false,
      limits: limitsOf(channel),
    });
  });
}

export function drawSpectra() {
  const { panel, component } = page;
  if (!panel || view.paused || !rows.length) return;
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
  waterfall($("waterfall"), rows, shown, Number($("waterfall-of").value));
}

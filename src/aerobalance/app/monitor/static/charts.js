// Strip charts on canvases. A column of pixels shows the least and the largest value of all bins that fall into it.

export class Ring {
  constructor(size, columns) {
    this.size = size;
    this.columns = columns;
    this.data = new Float32Array(size * columns * 2).fill(NaN);
    this.first = 0;
    this.end = 0;
  }

  put(first, count, values) {
    const width = this.columns * 2;
    if (this.end === 0 || first < this.first || first - this.end > this.size) {
      this.data.fill(NaN);
      this.first = first;
      this.end = first;
    }
    for (let bin = this.end; bin < first; bin++)
      this.data.fill(NaN, (bin % this.size) * width, ((bin % this.size) + 1) * width);
    for (let k = 0; k < count; k++)
      this.data.set(values.subarray(k * width, (k + 1) * width), ((first + k) % this.size) * width);
    this.end = first + count;
    this.first = Math.max(this.first, this.end - this.size);
  }

  // As it is now: what comes later does not change it.
  copy() {
    const made = Object.assign(Object.create(Ring.prototype), this);
    made.data = this.data.slice();
    return made;
  }

  // Least and largest value of bins [from, to) of a column into out; false where there is none.
  range(from, to, column, out) {
    let least = Infinity,
      largest = -Infinity;
    const width = this.columns * 2;
    for (let bin = Math.max(from, this.first), stop = Math.min(to, this.end); bin < stop; bin++) {
      const at = (bin % this.size) * width + column * 2,
        low = this.data[at],
        high = this.data[at + 1];
      if (low < least) least = low;
      if (high > largest) largest = high;
    }
    out[0] = least;
    out[1] = largest;
    return least <= largest;
  }
}

// Canvases take no light-dark(): as properties of a registered kind the page's colours are read as what they come to.
for (const name of ["band", "bad", "force", "grid", "ink", "muted", "raw", "third"])
  CSS.registerProperty({ name: `--${name}`, syntax: "<color>", inherits: true, initialValue: "gray" });

export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

export function fit(canvas) {
  const ratio = window.devicePixelRatio || 1,
    width = canvas.clientWidth,
    height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const paper = canvas.getContext("2d");
  paper.setTransform(ratio, 0, 0, ratio, 0, 0);
  paper.clearRect(0, 0, width, height);
  return { paper, width, height };
}

export function wipe(canvas) {
  fit(canvas);
}

export function nice(span, count) {
  const raw = span / Math.max(count, 1),
    power = 10 ** Math.floor(Math.log10(raw || 1)),
    part = raw / power;
  return power * (part <= 1 ? 1 : part <= 2 ? 2 : part <= 5 ? 5 : 10);
}

export function number(value, digits = 4) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size === 0) return "0";
  let text;
  if (size !== 0 && (size >= 1e6 || size < 1e-4)) text = value.toExponential(digits - 1);
  else {
    const places = Math.max(0, Math.min(6, digits - 1 - Math.floor(Math.log10(Math.max(size, 1e-3)))));
    text = value.toFixed(places);
    if (Number(text) === 0) text = text.replace("-", "");
  }
  return text.replace("-", "−");
}

// Values of a scale's lines, two at least, and how many decimals they need.
export function ticks(low, high, count) {
  let step = nice(high - low, count);
  const values = () => {
    const found = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
    return found;
  };
  for (let k = 0; k < 9 && values().length < 2; k++) step = nice(step / 3, 1); // the next finer one
  return { values: values(), places: Math.max(0, Math.min(5, -Math.floor(Math.log10(step) + 1e-9))) };
}

export const label = (value, places) =>
  Math.abs(value) >= 1e5 ? value.toExponential(1).replace("-", "−") : fixed(value, places);

// As many decimals as the spread of the readings bears.
export function rounded(value, spread) {
  return spread > 0 ? fixed(value, Math.max(0, Math.min(6, 2 - Math.floor(Math.log10(spread))))) : number(value);
}

export function fixed(value, places) {
  const text = value.toFixed(places);
  return (Number(text) === 0 ? text.replace("-", "") : text).replace("-", "−");
}

const SLACK = 700; // time that a scale stays although much of it is empty [ms]

// Follows the values shown: grows at once, shrinks when much of it has been empty for a while.
export class Scale {
  constructor() {
    this.low = NaN;
    this.high = NaN;
    this.since = 0;
    this.locked = false;
  }

  follow(least, largest, now) {
    if (!(least <= largest) || (this.locked && this.low < this.high)) return;
    const span = largest > least ? largest - least : Math.abs(largest) * 0.02 || 1,
      pad = 0.08 * span;
    const low = least - pad,
      high = largest + pad;
    if (!(this.low <= low && this.high >= high)) {
      this.low = Math.min(low - pad, Number.isNaN(this.low) ? low : this.low);
      this.high = Math.max(high + pad, Number.isNaN(this.high) ? high : this.high);
      this.since = now;
    }
    if (high - low > 0.6 * (this.high - this.low)) this.since = now;
    if (now - this.since > SLACK) {
      this.low = low - pad;
      this.high = high + pad;
      this.since = now;
    }
  }
}

function trace(paper, ring, column, view, low, high) {
  const { left, width, top, height, begin, bins } = view,
    pair = [0, 0];
  const y = (value) => top + height * (1 - (value - low) / (high - low));
  paper.beginPath();
  let before = null;
  const columns = Math.min(width, bins),
    step = bins / columns,
    apart = width / columns;
  const start = Math.ceil(begin / step) * step; // columns stay with their bins, so that nothing flickers
  for (let k = 0; k <= columns; k++) {
    const from = start + k * step,
      some = ring.range(Math.round(from), Math.max(Math.round(from) + 1, Math.round(from + step)), column, pair);
    const x = left + ((from - begin) / bins) * width;
    if (x > left + width) break;
    if (!some) {
      before = null;
      continue;
    }
    const above = y(pair[1]),
      below = y(pair[0]);
    if (before === null) paper.moveTo(x, above);
    else if (apart < 2) paper.lineTo(x, before < (above + below) / 2 ? above : below);
    else paper.lineTo(x, above);
    if (below - above > 0.4) {
      paper.lineTo(x, above);
      paper.lineTo(x, below);
    } else paper.lineTo(x, (above + below) / 2 + 0.01);
    before = below;
  }
  paper.stroke();
}

function band(paper, ring, view, low, high) {
  const { left, width, top, height, begin, bins } = view,
    pair = [0, 0],
    doubt = [0, 0];
  const y = (value) => top + height * (1 - (value - low) / (high - low));
  const upper = [],
    lower = [];
  const columns = Math.min(width, bins),
    step = bins / columns,
    start = Math.ceil(begin / step) * step;
  for (let k = 0; k <= columns; k++) {
    const from = start + k * step,
      to = Math.max(Math.round(from) + 1, Math.round(from + step));
    const x = left + ((from - begin) / bins) * width;
    if (x > left + width || !ring.range(Math.round(from), to, 0, pair) || !ring.range(Math.round(from), to, 1, doubt))
      continue;
    upper.push([x, y(pair[1] + 1.96 * doubt[1])]);
    lower.push([x, y(pair[0] - 1.96 * doubt[1])]);
  }
  if (!upper.length) return;
  paper.beginPath();
  upper.forEach(([x, at], k) => (k ? paper.lineTo(x, at) : paper.moveTo(x, at)));
  lower.reverse().forEach(([x, at]) => paper.lineTo(x, at));
  paper.fill();
}

// Least and largest value of a line between two bins; null where it has none.
export function extent({ ring, column }, begin, end) {
  const pair = [0, 0];
  return ring.range(Math.floor(begin), end, column, pair) ? pair : null;
}

// Where the plot lies on the canvas of a strip chart.
export const plotOf = (canvas, axes) => {
  const left = axes ? 62 : 56;
  return { left, top: 6, width: canvas.clientWidth - left - 8, height: canvas.clientHeight - 6 - (axes ? 38 : 4) };
};

// Times below the plot: from the newest sample (or the end of what is held) back, and by the clock.
function timeAxis(paper, view, { end, zero, rate, seconds, clock, last: newest }) {
  const every = nice(seconds, view.width / 96),
    last = (end - zero) / rate,
    below = view.top + view.height;
  paper.textAlign = "center";
  paper.fillStyle = colour("muted");
  for (let k = Math.floor(last / every + 1e-9); k * every >= last - seconds - 1e-9; k--) {
    const at = k * every,
      x = view.left + view.width * (1 - (last - at) / seconds),
      text = k ? `−${Number(Math.abs(at).toPrecision(6))} s` : newest,
      shown = Math.min(x, view.left + view.width - 22);
    paper.fillText(text, shown, below + 12);
    const time = clock(zero + at * rate);
    if (time) paper.fillText(time, shown, below + 27);
  }
}

function valueAxis(paper, view, scale, axes) {
  const { low, high } = scale,
    found = ticks(low, high, view.height / (axes ? 45 : 26));
  paper.textAlign = "right";
  for (const value of found.values) {
    const y = view.top + view.height * (1 - (value - low) / (high - low));
    paper.strokeStyle = colour("grid");
    paper.beginPath();
    paper.moveTo(view.left, y);
    paper.lineTo(view.left + view.width, y);
    paper.stroke();
    paper.fillStyle = colour("muted");
    paper.fillText(label(value, found.places), view.left - 6, Math.max(y, 7));
  }
}

// The cursor, and what is about to be zoomed into: both as parts of the width.
function overlay(paper, view, { cursor, selection }) {
  if (selection) {
    paper.fillStyle = colour("band");
    const [from, to] = selection;
    paper.fillRect(view.left + from * view.width, view.top, (to - from) * view.width, view.height);
  }
  if (cursor === null || cursor === undefined) return;
  paper.strokeStyle = colour("ink");
  paper.beginPath();
  paper.moveTo(view.left + cursor * view.width, view.top);
  paper.lineTo(view.left + cursor * view.width, view.top + view.height);
  paper.stroke();
}

// Draw one strip chart. lines: [{ring, column, colour, width, band}]
export function strip(canvas, scale, options) {
  const { lines, end, rate, seconds, now, marks = [], limits = [], axes = true, unit = "" } = options;
  const { paper, width: whole } = fit(canvas);
  if (whole < 10) return;
  const plot = plotOf(canvas, axes),
    { left } = plot,
    view = { ...plot, begin: end - seconds * rate, bins: seconds * rate };
  const ends = lines.flatMap((line) => extent(line, view.begin, end) ?? []);
  scale.follow(Math.min(...ends), Math.max(...ends), now);
  if (!(scale.low < scale.high)) return;
  const { low, high } = scale,
    y = (value) => view.top + view.height * (1 - (value - low) / (high - low));
  paper.font = "12px system-ui, sans-serif";
  paper.lineWidth = 1;
  paper.textBaseline = "middle";
  valueAxis(paper, view, scale, axes);
  if (axes) {
    timeAxis(paper, view, options);
    paper.textAlign = "left";
    paper.fillText(unit ? `[${unit}]` : "", 2, 12);
  }
  paper.save();
  paper.beginPath();
  paper.rect(left, view.top, view.width, view.height);
  paper.clip();
  paper.setLineDash([6, 5]);
  paper.strokeStyle = colour("bad");
  for (const value of limits) {
    if (value > low && value < high) {
      paper.beginPath();
      paper.moveTo(left, y(value));
      paper.lineTo(left + view.width, y(value));
      paper.stroke();
    }
  }
  paper.setLineDash([]);
  for (const line of lines) {
    if (line.band) {
      paper.fillStyle = colour("band");
      band(paper, line.ring, view, low, high);
    }
    paper.strokeStyle = colour(line.colour);
    paper.lineWidth = line.width;
    paper.lineJoin = "round";
    trace(paper, line.ring, line.column, view, low, high);
  }
  paper.lineWidth = 1;
  paper.textAlign = "left";
  paper.textBaseline = "top";
  const taken = [[], [], []];
  for (const mark of marks) {
    const x = left + ((mark.bin - view.begin) / view.bins) * view.width;
    if (x < left || x > left + view.width) continue;
    paper.strokeStyle = colour("third");
    paper.setLineDash([2, 3]);
    paper.beginPath();
    paper.moveTo(x, view.top);
    paper.lineTo(x, view.top + view.height);
    paper.stroke();
    paper.setLineDash([]);
    if (axes) {
      paper.fillStyle = colour("third");
      const text = mark.text.length > 42 ? `${mark.text.slice(0, 40)}…` : mark.text,
        wide = paper.measureText(text).width;
      const from = x + 4 + wide > left + view.width ? x - 4 - wide : x + 4;
      const row = taken.findIndex((spans) =>
        spans.every(([begin, stop]) => from > stop + 6 || from + wide < begin - 6),
      );
      if (row >= 0) {
        taken[row].push([from, from + wide]);
        paper.fillText(text, from, view.top + 2 + 14 * row);
      }
    }
  }
  overlay(paper, view, options);
  paper.restore();
}

// Charts on canvases. A column of pixels shows the least and the largest value of all bins that fall into it.

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
for (const name of ["band", "bad", "force", "grid", "muted", "raw", "third"])
  CSS.registerProperty({ name: `--${name}`, syntax: "<color>", inherits: true, initialValue: "gray" });

export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

function fit(canvas) {
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

function nice(span, count) {
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

// As many decimals as the spread of the readings bears.
export function rounded(value, spread) {
  return spread > 0 ? fixed(value, Math.max(0, Math.min(6, 2 - Math.floor(Math.log10(spread))))) : number(value);
}

export function fixed(value, places) {
  const text = value.toFixed(places);
  return (Number(text) === 0 ? text.replace("-", "") : text).replace("-", "−");
}

// Follows the values shown: grows at once, shrinks when much of it has been empty for a while.
export class Scale {
  constructor() {
    this.low = NaN;
    this.high = NaN;
    this.since = 0;
  }

  follow(least, largest, now) {
    if (!(least <= largest)) return;
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
    if (now - this.since > 1500) {
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

// Draw one strip chart. lines: [{ring, column, colour, width, band}]
export function strip(canvas, scale, options) {
  const { lines, end, rate, seconds, now, marks = [], limits = [], axes = true, unit = "" } = options;
  const { paper, width: whole, height: tall } = fit(canvas);
  if (whole < 10) return;
  const left = axes ? 62 : 44,
    bottom = axes ? 22 : 4,
    top = 6;
  const view = {
    left,
    top,
    width: whole - left - 8,
    height: tall - top - bottom,
    begin: end - seconds * rate,
    bins: seconds * rate,
  };
  const ends = lines.flatMap((line) => extent(line, view.begin, end) ?? []);
  scale.follow(Math.min(...ends), Math.max(...ends), now);
  if (!(scale.low < scale.high)) return;
  const { low, high } = scale,
    y = (value) => view.top + view.height * (1 - (value - low) / (high - low));
  paper.font = "12px system-ui, sans-serif";
  paper.lineWidth = 1;
  paper.textBaseline = "middle";
  paper.textAlign = "right";
  const step = nice(high - low, axes ? view.height / 45 : 2),
    places = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  for (let value = Math.ceil(low / step) * step; value <= high; value += step) {
    paper.strokeStyle = colour("grid");
    paper.beginPath();
    paper.moveTo(left, y(value));
    paper.lineTo(left + view.width, y(value));
    paper.stroke();
    paper.fillStyle = colour("muted");
    paper.fillText(
      Math.abs(value) >= 1e5
        ? value.toExponential(0)
        : value
            .toFixed(Math.min(places, 5))
            .replace("-", "−")
            .replace(/^−(0(\.0*)?)$/, "$1"),
      left - 6,
      y(value),
    );
  }
  if (axes) {
    const every = nice(seconds, view.width / 90);
    paper.textAlign = "center";
    paper.fillStyle = colour("muted");
    for (let back = 0; back <= seconds + 1e-9; back += every) {
      const x = left + view.width * (1 - back / seconds);
      paper.fillText(
        back ? `−${Number(back.toPrecision(6))} s` : "now",
        Math.min(x, left + view.width - 12),
        tall - 9,
      );
    }
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
  paper.restore();
}

const VIRIDIS = [
  [68, 1, 84],
  [72, 40, 120],
  [62, 74, 137],
  [49, 104, 142],
  [38, 130, 142],
  [31, 158, 137],
  [53, 183, 121],
  [109, 205, 89],
  [180, 222, 44],
  [253, 231, 37],
];

function viridis(part) {
  const place = Math.max(0, Math.min(0.9999, part)) * (VIRIDIS.length - 1),
    k = Math.floor(place),
    rest = place - k;
  return VIRIDIS[k].map((value, i) => value + (VIRIDIS[k + 1][i] - value) * rest);
}

function decades(rows) {
  let low = Infinity,
    high = -Infinity;
  for (const row of rows)
    for (const value of row) {
      if (value > 0) {
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
  if (!(low < high)) return null;
  return { low: Math.max(Math.log10(low), Math.log10(high) - 5), high: Math.log10(high) + 0.1 };
}

export function spectrum(canvas, row, lines, largest, marks, unit) {
  const { paper, width: whole, height: tall } = fit(canvas);
  if (!row || whole < 10) return;
  const left = 62,
    bottom = 22,
    top = 6,
    width = whole - left - 8,
    height = tall - top - bottom,
    range = decades([row.subarray(0, 2 * lines)]);
  if (!range) return;
  const y = (value) =>
    top + height * (1 - (Math.log10(Math.max(value, 1e-30)) - range.low) / (range.high - range.low));
  paper.font = "12px system-ui, sans-serif";
  paper.textBaseline = "middle";
  paper.textAlign = "right";
  paper.lineWidth = 1;
  for (let power = Math.ceil(range.low); power <= range.high; power++) {
    paper.strokeStyle = colour("grid");
    paper.beginPath();
    paper.moveTo(left, y(10 ** power));
    paper.lineTo(left + width, y(10 ** power));
    paper.stroke();
    paper.fillStyle = colour("muted");
    paper.fillText(
      power < -3 || power > 4 ? `1e${power}`.replace("-", "−") : String(10 ** power),
      left - 6,
      y(10 ** power),
    );
  }
  paper.textAlign = "center";
  const every = nice(largest, width / 80);
  for (let at = 0; at <= largest; at += every) {
    paper.fillStyle = colour("muted");
    paper.fillText(
      `${Number(at.toPrecision(6))}${at ? "" : " Hz"}`,
      Math.min(left + (width * at) / largest + (at ? 0 : 8), whole - 24),
      tall - 9,
    );
  }
  paper.textAlign = "left";
  paper.fillText(`[${unit}]`, 2, 12);
  paper.save();
  paper.beginPath();
  paper.rect(left, top, width, height);
  paper.clip();
  for (const at of marks) {
    paper.strokeStyle = colour("third");
    paper.setLineDash([2, 3]);
    paper.beginPath();
    paper.moveTo(left + (width * at) / largest, top);
    paper.lineTo(left + (width * at) / largest, top + height);
    paper.stroke();
  }
  paper.setLineDash([]);
  for (const [column, name, wide] of [
    [0, "raw", 1.2],
    [1, "force", 1.8],
  ]) {
    paper.strokeStyle = colour(name);
    paper.lineWidth = wide;
    paper.beginPath();
    for (let k = 0; k < lines; k++) {
      const x = left + (width * (k + 0.5)) / lines;
      if (k) paper.lineTo(x, y(row[2 * k + column]));
      else paper.moveTo(x, y(row[2 * k + column]));
    }
    paper.stroke();
  }
  paper.restore();
}

export function waterfall(canvas, rows, lines, column) {
  const { paper, width: whole, height: tall } = fit(canvas);
  const left = 62,
    width = whole - left - 8;
  if (!rows.length || width < 10) return;
  const range = decades(rows.slice(-20).map((row) => row.filter((_, k) => k % 2 === column)));
  if (!range) return;
  const low = Math.max(range.low, range.high - 4),
    picture = new ImageData(lines, 120);
  for (let r = 0; r < Math.min(rows.length, 120); r++) {
    const row = rows[rows.length - 1 - r];
    for (let k = 0; k < lines; k++) {
      const [red, green, blue] = viridis(
          (Math.log10(Math.max(row[2 * k + column], 1e-30)) - low) / (range.high - low),
        ),
        at = 4 * (r * lines + k);
      picture.data[at] = red;
      picture.data[at + 1] = green;
      picture.data[at + 2] = blue;
      picture.data[at + 3] = 255;
    }
  }
  const store = (waterfall.store ??= new OffscreenCanvas(lines, 120));
  if (store.width !== lines) store.width = lines;
  store.getContext("2d").putImageData(picture, 0, 0);
  paper.imageSmoothingEnabled = true;
  paper.drawImage(store, left, 0, width, tall);
  paper.font = "12px system-ui, sans-serif";
  paper.fillStyle = colour("muted");
  paper.textAlign = "right";
  paper.textBaseline = "top";
  paper.fillText("now", left - 6, 0);
  paper.textBaseline = "bottom";
  paper.fillText("−1 min", left - 6, tall);
}

// Spectra on canvases: the newest as lines, those of the last minute as a waterfall with its colour scale.

import { colour, fit, nice, number } from "./charts.js";

const LEFT = 62; // where plots begin, as in the strip charts

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

const powerOf = (power) => (power < -3 || power > 4 ? `1e${power}`.replace("-", "−") : String(10 ** power));

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
  const left = LEFT,
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
    paper.fillText(powerOf(power), left - 6, y(10 ** power));
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
  const left = LEFT,
    width = whole - left - 8;
  if (!rows.length || width < 10) return null;
  const range = decades(rows.slice(-20).map((row) => row.filter((_, k) => k % 2 === column)));
  if (!range) return null;
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
  return { low, high: range.high };
}

// What the colours of the waterfall mean.
export function colourScale(canvas, range, unit) {
  const { paper, width: whole } = fit(canvas);
  if (!range || whole < 10) return;
  const { low, high } = range,
    width = whole - LEFT - 8,
    x = (power) => LEFT + (width * (power - low)) / (high - low);
  for (let at = 0; at < width; at++) {
    const [red, green, blue] = viridis(at / width).map(Math.round);
    paper.fillStyle = `rgb(${red}, ${green}, ${blue})`;
    paper.fillRect(LEFT + at, 0, 1.5, 10);
  }
  paper.font = "12px system-ui, sans-serif";
  paper.fillStyle = colour("muted");
  paper.strokeStyle = colour("muted");
  paper.textBaseline = "top";
  paper.textAlign = "left";
  paper.fillText(`[${unit}]`, 2, 0);
  const powers = [];
  for (let power = Math.ceil(low); power <= high; power++) powers.push(power);
  const shown = powers.length > 1 ? powers.map((power) => [power, powerOf(power)]) : [low, high].map((at) => [at, number(10 ** at, 2)]);
  for (const [power, text] of shown) {
    paper.textAlign = x(power) < LEFT + 20 ? "left" : x(power) > whole - 28 ? "right" : "center";
    paper.beginPath();
    paper.moveTo(x(power), 8);
    paper.lineTo(x(power), 13);
    paper.stroke();
    paper.fillText(text, x(power), 14);
  }
}

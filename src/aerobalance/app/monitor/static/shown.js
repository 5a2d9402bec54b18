// What all parts of the page look at: the source, how everything stands, and counters for whoever watches the page.

export const page = {
  panel: null,
  state: null,
  numbers: {},
  marks: [],
  component: "",
  lost: true, // whether the server is out of reach, so that nothing shown is of now
  stale: false, // whether the newest sample is older than it should be
  pressed: null, // the record that was asked for and is not yet in the state: its file, and when
};

export const counters = {
  frames: 0,
  updates: 0,
  latency: { newest: null, oldest: null },
  force: null,
  load: null,
  shown: { felt: null, force: null },
  scale: null,
  cursor: null,
  envelope: null,
  touching: null,
  source: null,
  record: null,
  pressed: null,
  alarms: null,
  check: null,
  lost: true,
  age: null,
  gaps: 0,
};
window.aerobalance = counters;

const SIGNS = { "*": "·", "^2": "²", rad: "°" };

// As units are written on the page.
export const written = (unit) => unit.replace(/\*|\^2|^rad$/g, (sign) => SIGNS[sign]);

// Angles are in degrees on the page.
export const unitOf = (place) => written(page.panel.units[place]);
export const factorOf = (place) => (page.panel.units[place] === "rad" ? 180 / Math.PI : 1);

export const clockTime = (ms, places = 0) => {
  const at = new Date(ms);
  const two = (value) => String(value).padStart(2, "0");
  const rest = places ? (at.getMilliseconds() / 1e3).toFixed(places + 1).slice(1, 2 + places) : "";
  return `${two(at.getHours())}:${two(at.getMinutes())}:${two(at.getSeconds())}${rest}`;
};

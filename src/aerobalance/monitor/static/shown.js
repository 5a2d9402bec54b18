// What all parts of the page look at: the source, how everything stands, and counters for whoever watches the page.

export const page = { panel: null, state: null, numbers: {}, marks: [], component: "" };

export const counters = {
  frames: 0,
  updates: 0,
  latency: { newest: null, oldest: null },
  force: null,
  load: null,
  shown: { felt: null, force: null },
  envelope: null,
  touching: null,
  source: null,
  record: null,
  check: null,
  gaps: 0,
};
window.aerobalance = counters;

const SIGNS = { "*": "·", "^2": "²", rad: "°" };

// Angles are in degrees on the page.
export const unitOf = (place) => page.panel.units[place].replace(/\*|\^2|^rad$/g, (sign) => SIGNS[sign]);
export const factorOf = (place) => (page.panel.units[place] === "rad" ? 180 / Math.PI : 1);

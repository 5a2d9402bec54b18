// Big numbers with their limits, and the load envelope.

import { fixed, number, rounded } from "./charts.js";
import { $, element } from "./dom.js";
import { beginHealth, showHealth } from "./health.js";
import { counters, factorOf, page, unitOf } from "./shown.js";

const LOADS = /^(NF|PM|SF|YM|RM|AF)$/;
const STATES = {
  ok: "● within limits",
  high: "▲ high",
  over: "■ over the limit",
  none: "– no readings",
  free: "– no limits set",
};
const HIGH = 0.8; // part of the envelope from which on it is shown as high
const STEPPED = 5000; // time that a step stays told beside the number [ms]

const cards = new Map();
let envelope = null;

export function beginNumbers() {
  const { panel } = page,
    loads = panel.names.filter((name) => LOADS.test(name)),
    many = loads.length > 1;
  cards.clear();
  for (const name of loads) cards.set(name, makeCard(name, many));
  envelope = makeEnvelope();
  const head = ["", "balance load", "force applied"].map((text) => element("span", {}, text));
  const none = element(
    "p",
    { class: "hint" },
    "None of the channels is a load (NF, PM, SF, YM, RM, AF). Name them in the set-up, or give the balance matrix of the gauge outputs.",
  );
  $("numbers").className = many ? "rows" : "";
  $("numbers").replaceChildren(
    envelope.card,
    ...(many ? [element("div", { class: "head hint" }, ...head)] : []),
    ...[...cards.values()].map(({ card }) => card),
    ...(loads.length ? [] : [none]),
  );
  $("numbers-note").hidden = !loads.length;
  beginHealth();
}

function makeGauge(label) {
  const bar = element("i"),
    gauge = element(
      "div",
      { class: "gauge", role: "meter", "aria-valuemin": 0, "aria-valuemax": 100, "aria-label": label },
      bar,
      element("u"),
    );
  return { gauge, bar };
}

function setGauge({ gauge, bar }, share) {
  bar.style.width = `${Math.min(100, 100 * share)}%`;
  gauge.setAttribute("aria-valuenow", Math.round(100 * share));
}

// One load has a card with room for words, several have a row each: all of them are in sight.
function makeCard(name, small) {
  const { panel } = page,
    unit = unitOf(panel.names.indexOf(name));
  const span = (kind) => element("span", { class: kind });
  const parts = { name, unit, small, step: {} };
  for (const key of ["state", "felt", "applied", "doubt", "share"]) parts[key] = span(key);
  for (const key of ["ends", "reach"]) parts[key] = span(`${key} u`);
  parts.felt.textContent = parts.applied.textContent = "–";
  parts.meter = makeGauge(`Balance load of ${name} over its limit`);
  const own = panel.components.includes(name),
    kind = small ? "" : "big ",
    of = (what) => element("span", { class: "u" }, ` ${what}`);
  const felt = element("span", { class: `${kind}value` }, parts.felt, of(unit)),
    applied = element("span", { class: `${kind}value applied`, hidden: !own }, parts.applied, parts.doubt, small ? "" : of(unit));
  parts.card = small
    ? element(
        "div",
        { class: "card none row-card" },
        element("span", { class: "name" }, parts.state, ` ${name}`),
        felt,
        applied,
        element("span", { class: "u" }, parts.share),
        parts.ends,
        parts.reach,
        parts.meter.gauge,
      )
    : element(
        "div",
        { class: "card none" },
        element("h3", {}, element("span", {}, name), parts.state),
        element("p", { class: "term" }, "balance load"),
        felt,
        parts.ends,
        parts.meter.gauge,
        element("p", { class: "hint" }, parts.share),
        element("p", { class: "term", hidden: !own }, "force applied"),
        applied,
        parts.reach,
      );
  return parts;
}

function makeEnvelope() {
  const parts = {
    state: element("span", { class: "state" }),
    share: element("span", { class: "value" }),
    nearest: element("span", { class: "hint" }),
    meter: makeGauge("Part of the load envelope that the loads take up"),
  };
  parts.card = element(
    "div",
    { class: "card none", id: "envelope", hidden: true },
    element("p", { class: "line" }, element("b", {}, "Combined loads"), parts.share, parts.nearest, parts.state),
    parts.meter.gauge,
  );
  return parts;
}

export function showNumbers() {
  if (!page.panel) return;
  const { numbers } = page;
  showEnvelope(numbers.envelope);
  for (const [name, parts] of cards) {
    const reading = numbers.readings?.[name],
      estimate = numbers.estimates?.[name];
    if (reading) showLoad(name, parts, reading);
    if (estimate) showForce(parts, estimate);
    if (name === page.component) {
      if (reading) counters.load = { ...reading };
      if (estimate) counters.force = { ...estimate };
    }
  }
  page.panel.names.forEach((name, place) => {
    const reading = numbers.readings?.[name],
      factor = factorOf(place);
    if (reading)
      $(`value-${place}`).textContent =
        reading.mean === null ? "–" : rounded(factor * reading.mean, factor * (reading.largest - reading.least));
  });
  counters.touching = numbers.touching ?? null;
  showHealth();
}

function showEnvelope(found) {
  envelope.card.hidden = !found;
  counters.envelope = found ?? null;
  if (!found) return;
  const state = found.share >= 1 ? "over" : found.share >= HIGH ? "high" : "ok";
  envelope.card.className = `card ${state}`;
  envelope.state.textContent = state === "over" ? "■ outside" : state === "high" ? "▲ near its edge" : "● inside";
  envelope.share.textContent = `${number(100 * found.share, 3)} %`;
  setGauge(envelope.meter, found.share);
  envelope.nearest.textContent = `most by ${found.nearest}`;
}

// What a mean is of: the time, or what has followed a step; that is told for some seconds, as nobody reads faster.
function meaning(parts, kind, { step, seconds, least, largest, uncertainty = 0 }) {
  const spread = Math.max(largest - least, uncertainty),
    coarse = parts.small ? Math.max(10 * spread, 100 * uncertainty) : spread, // rows are narrow
    range = `${rounded(least, coarse)} to ${rounded(largest, coarse)}`,
    now = performance.now();
  if (step) parts.step[kind] = { step, until: now + STEPPED };
  const last = parts.step[kind],
    told = last && last.until > now,
    height = told ? `${last.step > 0 ? "+" : ""}${number(last.step, 3)}` : "";
  const stepped = told ? `▲ step ${height}` : "";
  if (parts.small) return told ? `${stepped}; ${range}` : range;
  const time = number(seconds, 1),
    mean = step ? `mean of the ${time} s since` : `mean of ${time} s`;
  return told ? `${stepped} ${parts.unit}; ${mean}; ${range}` : `${mean}; ${range}`;
}

function showLoad(name, parts, reading) {
  const spread = reading.largest - reading.least,
    { half_ranges: halves, limits } = page.panel,
    state = reading.state === "ok" && !halves[name] && !limits[name] ? "free" : reading.state;
  parts.card.className = `card ${state}${parts.small ? " row-card" : ""}`;
  parts.state.textContent = parts.small ? STATES[state].slice(0, 1) : STATES[state];
  parts.state.title = STATES[state];
  if (reading.mean === null) {
    parts.felt.textContent = "–";
    parts.ends.textContent = "";
    return;
  }
  parts.felt.textContent = rounded(reading.mean, spread);
  parts.ends.textContent = meaning(parts, "felt", reading);
  parts.meter.gauge.hidden = reading.percent === null && reading.limit === null && reading.state !== "over";
  const share = reading.limit ?? (reading.percent ?? 0) / 100;
  setGauge(parts.meter, reading.state === "over" ? Math.max(1, share) : share); // of a limit at zero there is no share
  const words = [];
  if (limits[name] && reading.limit !== null) words.push(`${number(100 * reading.limit, 3)} % of its limit`);
  if (halves[name]) words.push(`${number(reading.percent, 3)} % of half range`);
  const part = page.numbers.envelope?.parts[name];
  if (part !== undefined) words.push(`${number(100 * part, 2)} % in the envelope`);
  const most = reading.limit === null ? reading.percent : 100 * reading.limit;
  parts.share.textContent = parts.small ? (most === null ? "" : `${number(most, 2)} %`) : words.join(", ");
  parts.share.title = words.join(", ");
}

function showForce(parts, estimate) {
  const { uncertainty } = estimate;
  if (estimate.force === null) {
    parts.applied.textContent = "–";
    parts.doubt.textContent = parts.reach.textContent = "";
    return;
  }
  const places = Math.max(0, Math.min(4, 1 - Math.floor(Math.log10(uncertainty || 1))));
  parts.applied.textContent = fixed(estimate.force, places);
  parts.doubt.textContent = ` ± ${fixed(uncertainty, places)}`;
  parts.reach.textContent = meaning(parts, "force", estimate);
}

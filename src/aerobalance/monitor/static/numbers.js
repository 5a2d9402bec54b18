// Big numbers with their limits, the load envelope, and the state of health.

import { fixed, number, rounded } from "./charts.js";
import { $, element } from "./dom.js";
import { counters, factorOf, page, unitOf } from "./shown.js";

const LOADS = /^(NF|PM|SF|YM|RM|AF)$/;
const STATES = {
  ok: "● within limits",
  high: "▲ high",
  over: "■ over the limit",
  none: "– no readings",
  free: "– no limits set",
};
const SHORT = { ok: "● ok", high: "▲ high", over: "■ over", none: "– none", free: "– no limits" };
const PROCESSES = {
  "start-up": "learning: wide band so far",
  learned: "learned",
  fallback: "fallen back to a wide band",
};
const HIGH = 0.8; // part of the envelope from which on it is shown as high

const cards = new Map();
let envelope = null;

export function beginNumbers() {
  const { panel } = page,
    loads = panel.names.filter((name) => LOADS.test(name));
  cards.clear();
  for (const name of loads) cards.set(name, makeCard(name));
  envelope = makeEnvelope();
  $("numbers").className = panel.components.length > 1 ? "pairs" : "";
  const none = element(
    "p",
    { class: "hint" },
    "None of the channels is a load (NF, PM, SF, YM, RM, AF). Name them in the set-up, or give the balance matrix of the gauge outputs.",
  );
  $("numbers").replaceChildren(
    envelope.card,
    ...[...cards.values()].map(({ card }) => card),
    ...(loads.length ? [] : [none]),
  );
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

function makeCard(name) {
  const { panel } = page,
    unit = unitOf(panel.names.indexOf(name)),
    small = panel.components.length > 1;
  const span = (kind) => element("span", { class: kind }),
    parts = { state: span("state"), felt: span("big felt"), applied: span("big applied") };
  parts.ends = element("dd", { class: "ends u" });
  parts.doubt = element("dd", { class: "doubt u" });
  parts.share = element("p", { class: "hint share" });
  parts.meter = makeGauge(`Load felt of ${name} over its limit`);
  const value = (what) => element("dd", {}, what, " ", element("span", { class: "u" }, unit));
  const force = element(
    "dl",
    { hidden: !panel.components.includes(name) },
    element("dt", {}, "force applied"),
    value(parts.applied),
    element("dt"),
    parts.doubt,
  );
  parts.felt.textContent = parts.applied.textContent = "–";
  parts.small = small ? " small" : "";
  parts.card = element(
    "div",
    { class: `card none${parts.small}` },
    element("h3", {}, element("span", {}, name), parts.state),
    element("dl", {}, element("dt", {}, "load felt"), value(parts.felt), element("dt"), parts.ends),
    parts.meter.gauge,
    parts.share,
    force,
  );
  return parts;
}

function makeEnvelope() {
  const parts = {
    state: element("span", { class: "state" }),
    share: element("span", { class: "big" }),
    nearest: element("p", { class: "hint" }),
    meter: makeGauge("Part of the load envelope that the loads take up"),
  };
  parts.card = element(
    "div",
    { class: "card none", id: "envelope", hidden: true },
    element("h3", {}, element("span", {}, "Combined loads"), parts.state),
    element(
      "dl",
      {},
      element("dt", {}, "of the load envelope"),
      element("dd", {}, parts.share, " ", element("span", { class: "u" }, "%")),
    ),
    parts.meter.gauge,
    parts.nearest,
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
  $("contact-state").hidden = !numbers.touching;
  showHealth();
}

function showEnvelope(found) {
  envelope.card.hidden = !found;
  counters.envelope = found ?? null;
  if (!found) return;
  const state = found.share >= 1 ? "over" : found.share >= HIGH ? "high" : "ok";
  envelope.card.className = `card ${state}`;
  envelope.state.textContent = state === "over" ? "■ outside" : state === "high" ? "▲ near its edge" : "● inside";
  envelope.share.textContent = number(100 * found.share, 3);
  setGauge(envelope.meter, found.share);
  envelope.nearest.textContent = `most by ${found.nearest}`;
}

function showLoad(name, parts, reading) {
  const spread = reading.largest - reading.least,
    { half_ranges: halves, limits } = page.panel,
    state = reading.state === "ok" && !halves[name] && !limits[name] ? "free" : reading.state;
  parts.card.className = `card ${state}${parts.small}`;
  parts.state.textContent = (parts.small ? SHORT : STATES)[state];
  if (reading.mean === null) {
    parts.felt.textContent = "–";
    parts.ends.textContent = "";
    return;
  }
  parts.felt.textContent = rounded(reading.mean, spread);
  parts.ends.textContent = `${rounded(reading.least, spread)} to ${rounded(reading.largest, spread)}`;
  parts.meter.gauge.hidden = reading.percent === null && reading.limit === null;
  setGauge(parts.meter, reading.limit ?? (reading.percent ?? 0) / 100);
  const words = [],
    of = parts.small ? "" : "of ";
  if (halves[name]) words.push(`${number(reading.percent, 3)} % ${of}half range`);
  if (limits[name] && reading.limit !== null)
    words.push(`${number(100 * reading.limit, 3)} % ${of}${parts.small ? "" : "its "}limit`);
  const part = page.numbers.envelope?.parts[name];
  if (part !== undefined) words.push(`${number(100 * part, 2)} % ${parts.small ? "" : "in the "}envelope`);
  parts.share.textContent = words.join(", ");
}

function showForce(parts, estimate) {
  const band = 1.96 * estimate.uncertainty,
    places = Math.max(0, Math.min(4, 1 - Math.floor(Math.log10(band || 1))));
  parts.applied.textContent = fixed(estimate.force, places);
  parts.doubt.textContent = `± ${fixed(band, places)} (95 %)`;
}

const good = (text) => element("span", { class: "yes" }, `✓ ${text}`);
const bad = (text) => element("span", { class: "warn" }, `▲ ${text}`);

function healthOf(name, health) {
  if (health.process === "waiting") return [[name, "waiting for the first readings"]];
  const many = page.panel.components.length > 1,
    level = `(${number(health.mean_square, 3)}, limit ${number(health.mean_square_limit, 3)})`;
  const test = health.explained
    ? good(many ? "explained" : `readings are explained ${level}`)
    : bad(`readings are not explained ${level}`);
  const other = health.drifted && health.process === "learned",
    size = number(health.resonance, 3);
  const resonance = other
    ? bad(`rings ${health.resonance > 1 ? "more" : "less"} than the dynamics say (${size})`)
    : good(many ? "rings as identified" : `as identified (${size})`);
  const rest = `${PROCESSES[health.process]}; lag ${number(1e3 * health.lag, 3)} ms; noise of a reading ${number(health.noise, 3)}; ground end ${health.moving ? "moves" : "at rest"}`;
  if (many) return [[name, element("span", {}, test, " ", resonance, ` ${rest}`)]];
  return [
    [`${name}: innovation test`, test],
    [`${name}: resonance`, resonance],
    [`${name}: process`, rest],
  ];
}

function showHealth() {
  const { numbers, panel, state } = page,
    lines = [];
  for (const name of panel.components) if (numbers.health?.[name]) lines.push(...healthOf(name, numbers.health[name]));
  const saturated = Object.entries(numbers.saturated || {}).filter(([, count]) => count > 0);
  lines.push([
    "Saturation",
    saturated.length ? bad(saturated.map(([name, count]) => `${name} ${count} readings`).join(", ")) : good("none"),
  ]);
  if (numbers.touching !== null && numbers.touching !== undefined)
    lines.push([
      "Contact circuit",
      numbers.touching ? bad("closed: the loads carry the force of the contact") : good("open"),
    ]);
  counters.gaps = page.marks.filter((mark) => ["gap", "remark", "restart"].includes(mark.kind)).length;
  lines.push(["Gaps on the way here", numbers.lost ? bad(`${numbers.lost} samples of each channel`) : good("none")]);
  if (state?.record.file)
    lines.push([
      "Gaps in the record",
      state.record.gaps ? bad(`${state.record.gaps}, ${state.record.lost} samples`) : good("none"),
    ]);
  lines.push([
    "Page",
    `${number(counters.updates, 3)} updates a second; sample to page ${number(counters.latency.newest?.p50, 3)} ms`,
  ]);
  const rows = lines.map(([name, what]) =>
    element("tr", {}, element("th", { scope: "row" }, name), element("td", {}, what)),
  );
  $("health").replaceChildren(element("table", {}, element("tbody", {}, ...rows)));
}

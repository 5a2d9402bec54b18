// Alarms: the worst in the header, all in a list, kept until they are acknowledged; a sound where it is wished.

import { number } from "./charts.js";
import { $, element, press } from "./dom.js";
import { clockTime, counters, page, written } from "./shown.js";

const BEEP = 2000; // time from one sound to the next [ms]

let sound = null; // what makes it: only after a press, as browsers want

const open = () => page.state?.alarms.open ?? [];
const unseen = () => open().filter((alarm) => !alarm.acknowledged);

function valueOf(alarm) {
  return alarm.value === null ? "" : `${number(alarm.value)} ${written(alarm.unit)}`.trim();
}

function nameOf(alarm) {
  return alarm.what === "contact" ? "contact" : alarm.what;
}

function wordsOf(alarm) {
  const value = valueOf(alarm),
    what = alarm.what === "contact" ? "" : `${nameOf(alarm)} `,
    text = written(alarm.text);
  if (alarm.present) return `■ ${what}${text}${value ? `: ${value}` : ""}${alarm.acknowledged ? " (acknowledged)" : ""}`;
  return `■ ${clockTime(1e3 * alarm.began)} ${what}${text}${value ? `: ${value}` : ""}, now over`;
}

// The worst first: what is not acknowledged before what is, what is there before what was, the largest share before others.
function worst() {
  const rank = (alarm) => (alarm.acknowledged ? 0 : 2e6) + (alarm.present ? 1e6 : 0) + Math.min(alarm.share ?? 1e5, 1e5);
  return [...open()].sort((a, b) => rank(b) - rank(a))[0];
}

// What is high and not over: it is shown while it is, and not kept.
function nearest() {
  let found = null;
  for (const [name, reading] of Object.entries(page.numbers.readings ?? {}))
    if (reading.state === "high" && (!found || reading.limit > found.share)) found = { name, share: reading.limit };
  return found;
}

export function showAlarms() {
  if (!page.state) return;
  const first = worst(),
    more = open().length - 1,
    high = first || page.lost || page.stale ? null : nearest(),
    at = $("alarm-state");
  const text = first
    ? wordsOf(first) + (more > 0 ? ` (+${more})` : "")
    : high
      ? `▲ ${high.name} at ${number(100 * high.share, 2)} % of its limit`
      : page.lost || page.stale
        ? "– alarms not known"
        : "✓ no alarm";
  if (at.textContent !== text) at.textContent = text;
  at.title = text;
  at.className = `pill ${first ? (first.acknowledged ? "bad" : "alarm") : high ? "high" : ""}`;
  $("acknowledge").hidden = !unseen().length;
  $("acknowledge").disabled = page.lost;
  counters.alarms = open().map(({ what, present, acknowledged }) => ({ what, present, acknowledged: !!acknowledged }));
  const said = first && !first.acknowledged ? `Alarm: ${first.what}` : "";
  if ($("alarm-said").textContent !== said) $("alarm-said").textContent = said;
}

export function listAlarms() {
  if (!page.state) return;
  const { open: there, past } = page.state.alarms;
  const rows = [...there, ...past].map((alarm) =>
    element(
      "tr",
      {},
      element("td", { class: alarm.present ? "no" : "" }, alarm.present ? "■ there" : "over"),
      element("td", {}, nameOf(alarm)),
      element("td", {}, written(alarm.text)),
      element("td", { class: "n" }, valueOf(alarm) || "–"),
      element("td", { class: "n" }, String(alarm.times)),
      element("td", {}, clockTime(1e3 * alarm.began)),
      element("td", {}, clockTime(1e3 * alarm.last)),
      element("td", {}, alarm.acknowledged ? clockTime(1e3 * alarm.acknowledged) : "not yet"),
    ),
  );
  const head = ["", "What", "", "Worst", "Times", "First", "Last", "Acknowledged"].map((text, k) =>
    element("th", { class: k === 3 || k === 4 ? "n" : "", scope: "col" }, text),
  );
  const table = element(
    "table",
    {},
    element("thead", {}, element("tr", {}, ...head)),
    element("tbody", {}, ...rows),
  );
  $("alarm-list").replaceChildren(
    rows.length ? element("div", { class: "wide" }, table) : element("p", { class: "hint" }, "No alarm so far."),
  );
}

function beep() {
  if (!sound || !unseen().length || page.lost) return;
  const tone = sound.createOscillator(),
    level = sound.createGain();
  tone.frequency.value = 880;
  level.gain.value = 0.08;
  tone.connect(level).connect(sound.destination);
  tone.start();
  tone.stop(sound.currentTime + 0.18);
}

export function wireAlarms() {
  $("alarm-state").addEventListener("click", () => {
    $("alarms").hidden = !$("alarms").hidden;
    $("alarm-state").setAttribute("aria-expanded", String(!$("alarms").hidden));
    listAlarms();
  });
  $("acknowledge").addEventListener("click", () => press("acknowledge"));
  $("alarm-sound").addEventListener("change", () => {
    sound?.close();
    sound = $("alarm-sound").checked ? new AudioContext() : null;
    beep();
  });
  setInterval(beep, BEEP);
}

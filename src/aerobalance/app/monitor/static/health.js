// State of health: one line a component, with the numbers behind it where they are asked for.

import { number } from "./charts.js";
import { $, element } from "./dom.js";
import { counters, page, unitOf } from "./shown.js";

const PROCESSES = {
  "start-up": "still learning, wide band",
  learned: "learned",
  fallback: "fallen back to a wide band",
};

const lines = new Map(); // by what they are of: a line stays open while its words change

export function beginHealth() {
  lines.clear();
  $("health").replaceChildren();
}

function lineOf(name, detailed) {
  if (!lines.has(name)) {
    const sign = element("span", { class: "sign" }),
      words = element("span"),
      details = element("dl", { class: "details" });
    const head = [sign, element("b", {}, name), words];
    const made = detailed
      ? element("details", { class: "line" }, element("summary", {}, ...head), details)
      : element("p", { class: "line" }, ...head);
    lines.set(name, { sign, words, details });
    $("health").append(made);
  }
  return lines.get(name);
}

const set = (at, text) => {
  if (at.textContent !== text) at.textContent = text;
};

function put(name, ok, text, details = null) {
  const line = lineOf(name, details !== null);
  set(line.sign, ok === null ? "…" : ok ? "✓" : "▲");
  line.sign.className = `sign ${ok === null ? "" : ok ? "yes" : "warn"}`;
  set(line.words, text);
  line.words.className = ok === false ? "warn" : "";
  if (!details) return;
  if (line.details.children.length !== 2 * details.length)
    line.details.replaceChildren(...details.flatMap(([term]) => [element("dt", {}, term), element("dd")]));
  details.forEach(([, value], k) => set(line.details.children[2 * k + 1], value));
}

function showComponent(name, health) {
  if (health.process === "waiting") {
    put(name, null, "waiting for the first readings", []);
    return;
  }
  const drifted = health.drifted && health.process === "learned",
    unit = unitOf(page.panel.names.indexOf(name));
  const words = [
    health.explained ? "explained" : "not explained by the dynamics",
    drifted ? `rings ${health.resonance > 1 ? "more" : "less"} than identified` : "rings as identified",
    PROCESSES[health.process],
  ];
  put(name, health.explained && !drifted && health.process !== "fallback", words.join(", "), [
    ["innovation test", `${number(health.mean_square, 3)}, limit ${number(health.mean_square_limit, 3)}`],
    [
      "resonance over that identified",
      `${number(health.resonance, 3)}, limits ${health.resonance_limits.map((value) => number(value, 3)).join(" to ")}`,
    ],
    ["noise of a reading", `${number(health.noise, 3)} ${unit}`],
    ["the force lags by", `${number(1e3 * health.lag, 3)} ms`],
    ["ground end", health.moving ? "moves" : "at rest"],
  ]);
}

const VERDICTS = ["fit for use", "doubtful", "not usable"]; // the worst last

function showVerdict(numbers, panel) {
  const known = panel.components.map((name) => numbers.health?.[name]).filter((health) => health?.verdict);
  if (!panel.components.length) return;
  if (!known.length) {
    put("Forces", null, "waiting for the first");
    return;
  }
  const worst = VERDICTS[Math.max(...known.map((health) => VERDICTS.indexOf(health.verdict)))],
    reasons = known.flatMap((health) => health.doubts.map(reasonOf));
  put("Forces", worst === VERDICTS[0], [worst, ...reasons].join(". "));
}

function reasonOf(doubt) {
  const size = doubt.effect ? ` (error about ${number(doubt.effect, 2)} ${doubt.unit.replace("*", "·")})` : "";
  return `${doubt.text}${size}${doubt.advice ? `: ${doubt.advice}` : ""}`;
}

export function showHealth() {
  const { numbers, panel, state } = page;
  showVerdict(numbers, panel);
  for (const name of panel.components) if (numbers.health?.[name]) showComponent(name, numbers.health[name]);
  const saturated = Object.entries(numbers.saturated || {}).filter(([, count]) => count > 0);
  put(
    "Saturation",
    !saturated.length,
    saturated.length ? saturated.map(([name, count]) => `${name} ${count} readings`).join(", ") : "none",
  );
  if (numbers.touching !== null && numbers.touching !== undefined)
    put(
      "Contact circuit",
      !numbers.touching,
      numbers.touching ? "closed: the loads carry the force of the contact" : "open",
    );
  counters.gaps = page.marks.filter((mark) => ["gap", "remark", "restart"].includes(mark.kind)).length;
  put("Gaps on the way here", !numbers.lost, numbers.lost ? `${numbers.lost} samples of each channel` : "none");
  if (state?.record.file)
    put(
      "Gaps in the record",
      !state.record.gaps,
      state.record.gaps ? `${state.record.gaps}, ${state.record.lost} samples` : "none",
    );
  const updates = number(counters.updates, 3),
    late = number(counters.latency.newest?.p50, 3);
  put("Page", counters.updates > 0 ? true : null, `${updates} updates a second; sample to page ${late} ms`);
}

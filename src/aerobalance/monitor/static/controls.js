// How source and record stand, and what can be done with them: rig, checks, zero, record.

import { number } from "./charts.js";
import { $, button, element, press, tell, typed } from "./dom.js";
import { counters, page } from "./shown.js";

const SOURCES = { starting: "… starting", running: "● live", ended: "■ ended", failed: "■ failed" };
const FIELDS = {
  frequency: "Drive frequency [Hz]",
  amplitude: "Drive amplitude [N]",
  shake: "Ground end shakes by [m/s²]",
};
const BUTTONS = {
  cut: ["Cut the cable", "danger"],
  hang: ["Hang a new cable", ""],
  touch: ["Let the model touch", ""],
  release: ["Set it free", ""],
};
const SWITCHED = ["shunt"]; // by its check
const VERDICTS = { passed: ["✓ passed", "yes"], failed: ["■ failed", "no"], undecided: ["▲ not decided", "warn"] };

const heard = new Set();

function pill(id, text, kind, title = text) {
  const at = $(id);
  at.hidden = !text;
  at.textContent = text;
  at.className = `pill ${kind}`;
  at.title = title;
}

export function showState() {
  const { source, record, zeros, setup, check, messages, folder } = page.state;
  const recording = record.state === "recording",
    busy = recording || record.state === "waiting",
    running = source.state === "running";
  Object.assign(counters, { source: source.state, record: record.state, check: check.text ?? null });
  const why = source.state === "ended" || source.state === "failed" ? `: ${source.text}` : "";
  pill(
    "source-state",
    (SOURCES[source.state] || "") + why,
    running ? "good" : source.state === "starting" ? "" : "bad",
    source.text,
  );
  pill(
    "record-state",
    busy ? (recording ? `● REC ${record.seconds.toFixed(1)} s` : "◌ waiting for the trigger") : "",
    recording ? "rec" : "",
  );
  $("test").textContent = setup.name + (setup.file ? ` (${setup.file})` : "");
  $("folder").textContent = folder;
  document.title = `${recording ? "● " : ""}aerobalance: ${setup.name || "monitor"}`;
  if (document.activeElement !== $("rig")) $("rig").value = source.rig || "";
  for (const id of ["rig", "open-setup"]) $(id).disabled = busy;
  $("zero").disabled = busy || !running;
  const taken = Object.entries(zeros).map(([name, value]) => `${name} ${number(value)}`);
  $("clear-zero").disabled = busy || !taken.length;
  $("zero-state").textContent = taken.length ? `zero: ${taken.join(", ")}` : "no zero taken";
  $("record").disabled = busy || !running;
  $("stop").disabled = !busy;
  $("trigger").hidden = record.state !== "waiting";
  $("record-line").textContent = wordsOf(record, busy);
  $("record-line").className = record.full || record.touched ? "warn" : "hint";
  showControls(source, running);
  showChecks(check, running);
  for (const message of messages) {
    const key = `${message.number} ${message.time}`;
    if (heard.has(key)) continue;
    heard.add(key);
    if (Date.now() / 1e3 - message.time < 30 || message.kind === "error") tell(message.text, message.kind);
  }
}

function wordsOf(record, busy) {
  if (record.state === "none") return "";
  const gaps = record.gaps ? `${record.gaps} gap(s), ${record.lost} samples lost` : "no gaps",
    touched = record.touched ? `; touched ${record.touched} time(s)` : "";
  if (busy)
    return `${record.file}: ${record.seconds.toFixed(1)} s, ${record.blocks} blocks on the disk, ${gaps}${touched}; ${number(record.free / 1e9, 3)} GB left`;
  return `${record.file}: ${record.reason}; ${record.seconds.toFixed(2)} s, ${gaps}${touched}`;
}

function showControls(source, running) {
  const names = Object.keys(source.controls || {}).filter((name) => !SWITCHED.includes(name)),
    key = `${source.number}:${names}:${source.state}`,
    box = $("rig-controls");
  if (box.dataset.key === key) return;
  box.dataset.key = key;
  const buttons = names
    .filter((name) => BUTTONS[name])
    .map((name) =>
      button(BUTTONS[name][0], () => press("control", { name, value: 1 }), {
        id: `control-${name}`,
        class: BUTTONS[name][1],
        disabled: !running,
      }),
    );
  const made = buttons.length ? [element("div", { class: "row" }, ...buttons)] : [];
  made.push(...names.filter((name) => !BUTTONS[name]).map((name) => field(name, source.controls[name], running)));
  if (source.rig === "vibration")
    made.push(
      element(
        "div",
        { class: "row" },
        button("Stepped-sine run", () => press("sweep"), { id: "sweep", disabled: !running }),
        element("span", { class: "hint", id: "sweep-line" }),
      ),
    );
  if (!running && source.state !== "starting")
    made.push(
      element(
        "div",
        { class: "row" },
        button("Start the source again", () => press("restart"), { id: "restart", class: "primary" }),
      ),
    );
  box.replaceChildren(...made);
}

function field(name, value, running) {
  const input = element("input", {
    id: `control-${name}`,
    inputmode: "decimal",
    autocomplete: "off",
    value: value ?? "",
  });
  const set = (event) => {
    event.preventDefault();
    press("control", { name, value: typed(input.value) });
  };
  return element(
    "form",
    { class: "row", onsubmit: set },
    element("label", { class: "grow" }, FIELDS[name] || name, input),
    element("button", { type: "submit", disabled: !running }, "Set"),
  );
}

function showChecks(check, running) {
  for (const kind of ["shunt", "return"]) {
    const mine = check.kind === kind && check.waiting,
      at = $(`check-${kind}`);
    at.textContent = {
      shunt: mine ? "Shunt is on: take it" : "Shunt check",
      return: mine ? "At rest again: take it" : "Return to zero",
    }[kind];
    at.className = mine ? "primary" : "";
    at.disabled = !running || Boolean(check.busy) || (check.waiting && !mine);
  }
  $("check-give-up").hidden = !check.waiting;
  const [words, kind] = VERDICTS[check.verdict] || ["", "hint"];
  $("check-line").textContent = check.text ? (words ? `${words.slice(0, 1)} ${check.text}` : check.text) : "";
  $("check-line").className = kind;
  $("check-result").replaceChildren(...(check.rows?.length ? [resultOf(check)] : []));
}

function resultOf(check) {
  const head = ["", "Change", "Expected"].map((text, k) => element("th", { class: k ? "n" : "" }, text));
  const body = check.rows.map((row) => {
    const [words, kind] = VERDICTS[row.verdict],
      unit = row.unit.replace("*", "·");
    return element(
      "tr",
      {},
      element("td", { class: kind, title: words }, `${words.slice(0, 1)} ${row.channel} [${unit}]`),
      element("td", { class: "n" }, `${number(row.change)} ± ${number(row.expanded, 2)}`),
      element("td", { class: "n" }, `${number(row.expected)} ± ${number(row.tolerance, 2)}`),
    );
  });
  return element(
    "div",
    { class: "wide narrow" },
    element("table", {}, element("thead", {}, element("tr", {}, ...head)), element("tbody", {}, ...body)),
  );
}

export function wireControls() {
  $("rig").addEventListener("change", async () => {
    if ($("rig").value) await press("rig", { rig: $("rig").value });
    $("rig").blur();
  });
  $("zero").addEventListener("click", () => press("zero"));
  $("clear-zero").addEventListener("click", () => press("clear_zero"));
  for (const kind of ["shunt", "return"]) $(`check-${kind}`).addEventListener("click", () => press("test", { kind }));
  $("check-give-up").addEventListener("click", () => press("give_up"));
  $("mark-form").addEventListener("submit", (event) => {
    event.preventDefault();
    press("mark", { text: $("mark").value });
    $("mark").value = "";
  });
  $("record-form").addEventListener("submit", (event) => {
    event.preventDefault();
    const seconds = $("record-seconds").value.trim();
    press("record", {
      name: $("record-name").value,
      notes: $("record-notes").value,
      seconds: seconds ? typed(seconds) : null,
    });
  });
  $("stop").addEventListener("click", () => press("stop"));
  $("trigger").addEventListener("click", () => press("trigger"));
}

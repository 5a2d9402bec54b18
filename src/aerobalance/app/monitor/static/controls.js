// How source and record stand, and what can be done with them: rig, checks, zero, record.

import { number, rounded } from "./charts.js";
import { $, button, element, press, tell, typed } from "./dom.js";
import { counters, page, written } from "./shown.js";

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

const BUSY = ["starting", "waiting", "recording"];
const LONGEST = 1e7; // of a record [s]
const ANSWERED = 2000; // time from the answer to the state that shows what it was [ms]

const heard = new Set();

function pill(id, text, kind, title = text) {
  const at = $(id);
  at.hidden = !text;
  at.textContent = text;
  at.className = `pill ${kind}`;
  at.title = title;
}

// How the source and the record stand; nothing is claimed of them while the server is out of reach.
function showPills(source, record, stage) {
  if (page.lost) {
    pill("source-state", page.state ? "■ no connection" : "… connecting", page.state ? "bad" : "");
    pill("record-state", "", "");
    return;
  }
  const why = source.state === "ended" || source.state === "failed" ? `: ${source.text}` : "";
  pill(
    "source-state",
    (SOURCES[source.state] || "") + why,
    source.state === "running" ? "good" : source.state === "starting" ? "" : "bad",
    source.text,
  );
  const words = {
    starting: "● REC starting",
    waiting: "◌ waiting for the trigger",
    recording: `● REC ${record.seconds?.toFixed(1)} s`,
  };
  pill("record-state", words[stage] ?? "", stage === "waiting" ? "" : "rec");
}

// What was asked for is under way from the press on, until the state says how it went.
function stageOf(record) {
  const { pressed } = page;
  if (pressed && (BUSY.includes(record.state) || record.file === pressed.file || performance.now() > pressed.until))
    page.pressed = null;
  return page.pressed ? "starting" : record.state;
}

export function showState() {
  if (!page.state) {
    showPills({}, {}, "none");
    return;
  }
  const { source, record, zeros, setup, check, messages, folder } = page.state;
  const stage = stageOf(record),
    recording = stage === "recording",
    busy = BUSY.includes(stage),
    running = source.state === "running" && !page.lost;
  Object.assign(counters, { source: source.state, record: stage, check: check.text ?? null });
  showPills(source, record, stage);
  $("test").textContent = setup.name + (setup.file ? ` (${setup.file})` : "");
  $("folder").textContent = folder;
  document.title = `${page.lost ? "■ " : recording ? "● " : ""}aerobalance: ${setup.name || "monitor"}`;
  if (document.activeElement !== $("rig")) $("rig").value = source.rig || "";
  for (const id of ["rig", "open-setup"]) $(id).disabled = busy || page.lost;
  $("zero").disabled = busy || !running;
  const taken = Object.entries(zeros).map(([name, value]) => `${name} ${number(value)} ${zeroUnit(name)}`.trim());
  $("clear-zero").disabled = busy || !taken.length || page.lost;
  $("zero-state").textContent = taken.length ? `zero: ${taken.join(", ")}` : "no zero taken";
  $("record").disabled = busy || !running;
  $("record").textContent = stage === "starting" ? "Starting…" : "Record";
  $("record-seconds").placeholder = setup.seconds ? `${number(setup.seconds)}` : "until Stop";
  for (const id of ["stop", "stop-now"]) $(id).disabled = !busy || page.lost;
  $("stop-now").hidden = !busy || page.lost;
  $("trigger").hidden = stage !== "waiting";
  $("record-line").textContent = page.lost ? "" : wordsOf(record, stage);
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

function zeroUnit(name) {
  const place = page.panel?.names.indexOf(name) ?? -1;
  return place < 0 ? "" : written(page.panel.units[place]);
}

function wordsOf(record, stage) {
  if (stage === "starting") {
    const file = page.pressed?.file ?? record.file;
    return `${file}: starting; what is sampled since the press is in it`;
  }
  if (record.state === "none") return "";
  const gaps = record.gaps ? `${record.gaps} gap(s), ${record.lost} samples lost` : "no gaps",
    touched = record.touched ? `; touched ${record.touched} time(s)` : "";
  if (BUSY.includes(stage))
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
    const value = typed(input.value);
    if (!input.value.trim() || !Number.isFinite(value)) {
      tell(`${FIELDS[name] || name}: “${input.value}” is no number`, "error");
      input.focus();
    } else press("control", { name, value });
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

const between = (middle, half) => `${rounded(middle - half, half)} to ${rounded(middle + half, half)}`;

function resultOf(check) {
  const head = ["", "Change (95 %)", "Allowed"].map((text, k) => element("th", { class: k ? "n" : "" }, text));
  const body = check.rows.map((row) => {
    const [words, kind] = VERDICTS[row.verdict],
      unit = row.unit ? ` [${row.unit.replace("*", "·")}]` : "",
      read = row.change !== null;
    return element(
      "tr",
      {},
      element("td", { class: kind, title: words }, `${words.slice(0, 1)} ${row.channel}${unit}`),
      element("td", { class: "n" }, read ? between(row.change, row.expanded) : "no readings"),
      element("td", { class: "n" }, read ? between(row.expected, row.tolerance) : ""),
    );
  });
  return element(
    "div",
    { class: "wide narrow" },
    element("table", {}, element("thead", {}, element("tr", {}, ...head)), element("tbody", {}, ...body)),
  );
}

// The length that is typed: null for none, and undefined, with a sentence beside it, for what is none.
function lengthTyped() {
  const input = $("record-seconds"),
    text = input.value.trim(),
    seconds = typed(text),
    good = text === "" || (seconds > 0 && seconds <= LONGEST);
  input.setAttribute("aria-invalid", String(!good));
  input.classList.toggle("invalid", !good);
  $("length-error").hidden = good;
  if (good) return text === "" ? null : seconds;
  $("length-error").textContent =
    `“${text}” is no length: give a number of seconds above zero, such as 30 or 2,5; leave it empty to record until Stop.`;
  input.focus();
  return undefined;
}

async function begin(serverTime) {
  if ($("record").disabled) return;
  const seconds = lengthTyped(),
    name = $("record-name").value.trim().normalize("NFC");
  if (seconds === undefined) return;
  const at = serverTime(),
    file = /\.(h5|hdf5)$/i.test(name) ? name : `${name}.h5`;
  page.pressed = { file, until: Infinity };
  counters.pressed = at;
  showState();
  const found = await press("record", { name, notes: $("record-notes").value, seconds, pressed: at });
  if (page.pressed) page.pressed.until = found.error ? 0 : performance.now() + ANSWERED;
  showState();
}

export function wireControls(serverTime) {
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
    begin(serverTime);
  });
  $("record-seconds").addEventListener("input", () => $("length-error").hidden || lengthTyped() === undefined);
  for (const id of ["stop", "stop-now"]) $(id).addEventListener("click", () => press("stop"));
  $("trigger").addEventListener("click", () => press("trigger"));
}

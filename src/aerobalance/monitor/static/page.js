// The operator's page: takes frames from the server, draws them, and sends back what is asked for.

import { Ring, Scale, colour, number, spectrum, strip, waterfall } from "./charts.js";
import { openSetup } from "./setup.js";

const $ = (id) => document.getElementById(id);
const counters = window.aerobalance = { frames: 0, updates: 0, latency: { newest: null, oldest: null }, force: null, load: null, source: null, viewers: null, gaps: 0 };
const STEP = 10, PERIODS = 5;  // bins of a level in one of the next; natural frequencies that a spectrum shows

let socket = null, panel = null, state = null, numbers = {}, marks = [], rings = [], level = 1, paused = false, component = "", seconds = 10;
let newestTick = 0, offset = 0, bestTrip = Infinity, dirty = false, rows = [], largest = 0, frozen = 0, listed = -1;
const scales = new Map(), times = [], newest = [], oldest = [], dismissed = new Set(), cards = new Map();

export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (value === true) made.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) made.setAttribute(name, value);
  }
  made.append(...children);
  return made;
}

export async function act(action, body = {}) {
  let answer;
  try {
    answer = await fetch(`/api/${action}`, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body) });
  } catch { tell("the server does not answer", "error"); return { error: "the server does not answer" }; }
  const found = await answer.json().catch(() => ({ error: `the server answers with ${answer.status}` }));
  return answer.ok ? found : { error: found.error || `refused (${answer.status})`, where: found.where };
}

async function press(action, body = {}) {
  const found = await act(action, body);
  if (found.error) tell(found.error, "error");
  return found;
}

function tell(text, kind = "info") {
  const made = element("p", { class: kind }, element("span", {}, text), element("button", { type: "button", "aria-label": "Dismiss", onclick: () => made.remove() }, "×"));
  $("messages").prepend(made);
  while ($("messages").children.length > 4) $("messages").lastChild.remove();
  if (kind !== "error") setTimeout(() => made.remove(), 8000);
}

// ---- the connection

function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { $("lost-connection").hidden = true; panel = null; bestTrip = Infinity; send({ level, component }); for (let k = 0; k < 5; k++) setTimeout(ping, 300 * k); };
  socket.onclose = () => { $("lost-connection").hidden = false; setTimeout(connect, 1000); };
  socket.onmessage = ({ data }) => (typeof data === "string" ? heard(JSON.parse(data)) : frame(data));
}

const send = (message) => { if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message)); };
const clock = () => performance.timeOrigin + performance.now();
function ping() { send({ ping: clock() }); }
setInterval(() => { bestTrip *= 1.2; ping(); }, 5000);

function heard(message) {
  if (message.type === "state") { state = message; showState(); }
  else if (message.type === "panel") begin(message);
  else if (message.type === "numbers") { numbers = message; marks = message.marks; showNumbers(); }
  else if (message.type === "pong") {
    const now = clock(), trip = now - message.ping;
    if (trip <= bestTrip) { bestTrip = trip; offset = message.now - (now + message.ping) / 2; }
  }
}

function begin(message) {
  panel = message;
  makeRings();
  scales.clear(); rows = []; newest.length = 0; oldest.length = 0; numbers = {}; cards.clear();
  if (!panel.components.includes(component)) component = panel.components[0] || "";
  const tabs = panel.components.length > 1 ? panel.components : [];
  $("components").replaceChildren(...tabs.map((name) => element("button", { type: "button", "aria-pressed": String(name === component), onclick: () => choose(name) }, name)));
  $("no-force").hidden = panel.components.length > 0;
  const loads = panel.names.filter((name) => /^(NF|PM|SF|YM|RM|AF)$/.test(name));
  $("numbers").replaceChildren(...loads.map(makeCard));
  $("channels").replaceChildren(...panel.names.map((name, place) => element("div", { class: "channel" },
    element("p", {}, element("b", {}, name), element("span", { id: `value-${place}` }), element("span", { class: "u" }, unitOf(place))),
    element("canvas", { id: `channel-${place}`, role: "img", "aria-label": `Strip chart of ${name}` }))));
  send({ level, component });
}

const unitOf = (place) => panel.units[place].replace("*", "·").replace("^2", "²");

function makeRings() {
  rings = [new Ring(panel.kept[level], panel.names.length), ...panel.components.map(() => new Ring(panel.kept[level], 2))];
}

function choose(name) {
  component = name; rows = [];
  for (const button of $("components").children) button.setAttribute("aria-pressed", String(button.textContent === name));
  send({ component });
  dirty = true;
}

function frame(buffer) {
  const view = new DataView(buffer), kind = view.getUint8(0), sequence = view.getUint32(4, true);
  if (kind === 2) {
    // header: kind, component, rows, sequence, panel, largest frequency, lines
    const place = view.getUint8(1), count = view.getUint16(2, true), number_ = view.getUint32(8, true);
    send({ shown: sequence });
    if (!panel || number_ !== panel.number || panel.components[place] !== component) return;
    largest = view.getFloat32(12, true);
    const lines = view.getUint32(16, true), data = new Float32Array(buffer.slice(20));
    for (let k = 0; k < count; k++) rows.push(data.subarray(k * lines * 2, (k + 1) * lines * 2));
    rows = rows.slice(-120);
    requestAnimationFrame(drawSpectra);
    return;
  }
  const bins = view.getUint8(1), groups = view.getUint8(2), number_ = view.getUint32(8, true);
  if (panel && number_ === panel.number && bins === level) {
    let at = 40;
    for (let k = 0; k < groups; k++) {
      const place = view.getUint8(at), columns = view.getUint8(at + 1), count = view.getUint32(at + 4, true), first = view.getFloat64(at + 8, true);
      rings[place]?.put(first, count, new Float32Array(buffer, at + 16, count * columns * 2));
      at += 16 + count * columns * 8;
    }
    newestTick = view.getFloat64(32, true);
    dirty = true;
  }
  const fresh = view.getFloat64(16, true), old = view.getFloat64(24, true);
  requestAnimationFrame(() => {
    draw();
    const now = clock();
    if (fresh - old < 1000) { keep(newest, now + offset - fresh); keep(oldest, now + offset - old); }
    times.push(now);
    while (times.length && now - times[0] > 5000) times.shift();
    counters.frames += 1;
    send({ shown: sequence });
  });
}

function keep(list, value) { list.push(value); if (list.length > 2000) list.shift(); }
function part(list, share) { const sorted = [...list].sort((a, b) => a - b); return sorted.length ? sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))] : null; }

setInterval(() => {
  const now = clock();
  while (times.length && now - times[0] > 5000) times.shift();
  counters.updates = times.length / 5;
  counters.latency = { newest: { p50: part(newest, 0.5), p95: part(newest, 0.95) }, oldest: { p50: part(oldest, 0.5), p95: part(oldest, 0.95) } };
}, 500);

// ---- charts

function binRate() { return panel.rate / (panel.width * STEP ** level); }

function scaleOf(name) { if (!scales.has(name)) scales.set(name, new Scale()); return scales.get(name); }

function draw() {
  if (!panel || !dirty || document.hidden) return;
  dirty = false;
  const rate = binRate(), now = performance.now(), end = paused ? frozen : newestTick / (panel.width * STEP ** level);
  const shown = marks.map(({ tick, text }) => ({ bin: tick / (panel.width * STEP ** level), text })).filter((mark) => mark.bin > end - seconds * rate && mark.bin <= end);
  const place = panel.names.indexOf(component || panel.names[0]), force = panel.components.indexOf(component) + 1;
  const lines = [{ ring: rings[0], column: Math.max(place, 0), colour: "raw", width: 1 }];
  if (force > 0) lines.push({ ring: rings[force], column: 0, colour: "force", width: 2.2, band: true });
  strip($("main-chart"), scaleOf("main" + component), { lines, end, rate, seconds, now, marks: shown, limits: limitsOf(component || panel.names[0]), unit: unitOf(Math.max(place, 0)) });
  panel.names.forEach((name, column) => {
    const canvas = $(`channel-${column}`);
    const box = canvas.getBoundingClientRect();
    if (box.bottom < 0 || box.top > innerHeight) return;
    strip(canvas, scaleOf(name), { lines: [{ ring: rings[0], column, colour: "raw", width: 1 }], end, rate, seconds, now, marks: shown, axes: false, limits: limitsOf(name) });
  });
}

function limitsOf(name) {
  if (panel.limits[name]) return panel.limits[name].filter((value) => value !== null);
  const half = panel.half_ranges[name];
  return half ? [-half, half] : [];
}

function drawSpectra() {
  if (!panel || paused || !rows.length) return;
  const place = panel.names.indexOf(component), lines = rows[0].length / 2, natural = panel.frequencies[component];
  const shown = natural ? Math.min(lines, Math.ceil(lines * PERIODS * natural / largest)) : lines;
  spectrum($("spectrum"), rows[rows.length - 1], shown, largest * shown / lines, natural ? [natural] : [], unitOf(place));
  waterfall($("waterfall"), rows, shown, Number($("waterfall-of").value));
}

// ---- numbers

const STATES = { ok: "● within limits", high: "▲ high", over: "■ over the limit", none: "– no readings" };

function makeCard(name) {
  const unit = unitOf(panel.names.indexOf(name)), card = element("div", { class: "card none" });
  card.innerHTML = '<h3><span></span><span class="state"></span></h3><dl><dt>load felt</dt><dd><span class="big felt">–</span> <span class="u"></span></dd><dt></dt><dd class="ends u"></dd></dl><div class="gauge" role="meter" aria-valuemin="0" aria-valuemax="100"><i></i><u></u></div><p class="hint share"></p><dl><dt>force applied</dt><dd><span class="big applied">–</span> <span class="u"></span></dd><dt></dt><dd class="doubt u"></dd></dl>';
  card.querySelector("h3 span").textContent = name;
  card.querySelectorAll("dd > .u").forEach((item) => { item.textContent = unit; });
  card.querySelector(".gauge").setAttribute("aria-label", `Load felt of ${name} in percent of half its range`);
  card.querySelectorAll("dl")[1].hidden = !panel.components.includes(name);
  if (panel.components.length > 1) card.classList.add("small");
  cards.set(name, card);
  return card;
}

function showNumbers() {
  if (!panel) return;
  for (const [name, card] of cards) {
    const reading = numbers.readings?.[name], estimate = numbers.estimates?.[name];
    if (reading) {
      card.className = `card ${reading.state}${panel.components.length > 1 ? " small" : ""}`;
      card.querySelector(".state").textContent = STATES[reading.state] || reading.state;
      card.querySelector(".felt").textContent = shown(reading.mean, reading.largest - reading.least);
      card.querySelector(".ends").textContent = `${shown(reading.least, reading.largest - reading.least)} to ${shown(reading.largest, reading.largest - reading.least)}`;
      const gauge = card.querySelector(".gauge");
      gauge.hidden = reading.percent === null && reading.limit === null;
      const share = reading.limit ?? reading.percent / 100;
      gauge.firstChild.style.width = `${Math.min(100, 100 * share)}%`;
      gauge.setAttribute("aria-valuenow", Math.round(100 * share));
      card.querySelector(".share").textContent = reading.percent === null ? (reading.limit === null ? "no range given" : `${number(100 * reading.limit, 3)} % of its limit`)
        : `${number(reading.percent, 3)} % of half range${panel.limits[name] && reading.limit !== null ? `, ${number(100 * reading.limit, 3)} % of its limit` : ""}`;
    }
    if (estimate) {
      const band = 1.96 * estimate.uncertainty, places = Math.max(0, Math.min(4, 1 - Math.floor(Math.log10(band || 1))));
      card.querySelector(".applied").textContent = fixed(estimate.force, places);
      card.querySelector(".doubt").textContent = `± ${fixed(band, places)} (95 %)`;
      if (name === component) counters.force = { ...estimate };
    }
    if (name === component && reading) counters.load = { ...reading };
  }
  panel.names.forEach((name, place) => { const at = $(`value-${place}`), reading = numbers.readings?.[name]; if (at && reading) at.textContent = shown(reading.mean, reading.largest - reading.least); });
  showHealth();
}

// As many decimals as the spread of the readings bears.
function shown(value, spread) { return value === null ? "–" : spread > 0 ? fixed(value, Math.max(0, Math.min(6, 2 - Math.floor(Math.log10(spread))))) : number(value); }

function fixed(value, places) { const text = value.toFixed(places); return (Number(text) === 0 ? text.replace("-", "") : text).replace("-", "−"); }

function showHealth() {
  const lines = [], good = (text) => element("span", { class: "yes" }, `✓ ${text}`), bad = (text) => element("span", { class: "warn" }, `▲ ${text}`);
  const processes = { "start-up": "learning: wide band so far", learned: "learned", fallback: "fallen back to a wide band" };
  const many = panel.components.length > 1;
  for (const name of panel.components) {
    const health = numbers.health?.[name];
    if (!health) continue;
    if (health.process === "waiting") { lines.push([name, "waiting for the first readings"]); continue; }
    const limit = `(${number(health.mean_square, 3)}, limit ${number(health.mean_square_limit, 3)})`, drifted = health.drifted && health.process === "learned";
    const test = health.explained ? good(many ? "explained" : `readings are explained ${limit}`) : bad(`readings are not explained ${limit}`);
    const resonance = drifted ? bad(`rings ${health.resonance > 1 ? "more" : "less"} than the dynamics say (${number(health.resonance, 3)})`) : good(many ? "rings as identified" : `as identified (${number(health.resonance, 3)})`);
    const rest = `${processes[health.process]}; lag ${number(1e3 * health.lag, 3)} ms; noise of a reading ${number(health.noise, 3)}; ground end ${health.moving ? "moves" : "at rest"}`;
    if (many) { lines.push([name, element("span", {}, test, " ", resonance, ` ${rest}`)]); continue; }
    lines.push([`${name}: innovation test`, test], [`${name}: resonance`, resonance], [`${name}: process`, rest]);
  }
  const saturated = Object.entries(numbers.saturated || {}).filter(([, count]) => count > 0);
  lines.push(["Saturation", saturated.length ? bad(saturated.map(([name, count]) => `${name} ${count} readings`).join(", ")) : good("none")]);
  const gaps = marks.filter((mark) => mark.kind === "gap" || mark.kind === "remark" || mark.kind === "restart").length;
  counters.gaps = gaps;
  lines.push(["Gaps on the way here", numbers.lost ? bad(`${numbers.lost} samples of each channel`) : good("none")]);
  if (state?.record?.file) lines.push(["Gaps in the record", state.record.gaps ? bad(`${state.record.gaps}, ${state.record.lost} samples`) : good("none")]);
  lines.push(["Page", `${number(counters.updates, 3)} updates a second; sample to page ${number(counters.latency.newest?.p50, 3)} ms`]);
  $("health").replaceChildren(element("table", {}, element("tbody", {}, ...lines.map(([name, what]) => element("tr", {}, element("th", { scope: "row" }, name), element("td", {}, what))))));
}

// ---- state

function pill(id, text, kind) { const at = $(id); at.hidden = !text; at.textContent = text; at.className = `pill ${kind}`; at.title = text; }


function showState() {
  const { source, record } = state;
  counters.source = source.state; counters.record = record.state;
  const words = { starting: "… starting", running: "● live", ended: `■ ended: ${source.text}`, failed: `■ failed: ${source.text}` };
  pill("source-state", words[source.state] || "", source.state === "running" ? "good" : source.state === "starting" ? "" : "bad");
  const busy = record.state === "recording" || record.state === "waiting";
  $("source-state").title = source.text;
  pill("record-state", busy ? (record.state === "recording" ? `● REC ${record.seconds.toFixed(1)} s` : "◌ waiting for the trigger") : "", record.state === "recording" ? "rec" : "");
  $("test").textContent = state.setup.name + (state.setup.file ? ` (${state.setup.file})` : "");
  document.title = `${record.state === "recording" ? "● " : ""}aerobalance: ${state.setup.name || "monitor"}`;
  if (document.activeElement !== $("rig")) $("rig").value = source.rig || "";
  $("rig").disabled = busy; $("open-setup").disabled = busy; $("zero").disabled = busy; $("clear-zero").disabled = busy || !Object.keys(state.zeros).length;
  const zeros = Object.entries(state.zeros);
  $("zero-state").textContent = zeros.length ? `zero: ${zeros.map(([name, value]) => `${name} ${number(value, 4)}`).join(", ")}` : "no zero taken";
  $("record").disabled = busy || source.state !== "running"; $("stop").disabled = !busy; $("trigger").hidden = record.state !== "waiting";
  $("record-line").textContent = record.state === "none" ? "" : busy ? `${record.file}: ${record.seconds.toFixed(1)} s, ${record.blocks} blocks on the disk, ${record.gaps ? `${record.gaps} gap(s)` : "no gaps"}; ${number(record.free / 1e9, 3)} GB left`
    : `${record.file}: ${record.reason}; ${record.seconds.toFixed(2)} s, ${record.gaps ? `${record.gaps} gap(s), ${record.lost} samples lost` : "no gaps"}`;
  $("folder").textContent = state.folder;
  showControls(source);
  for (const message of state.messages) {
    if (dismissed.has(message.number)) continue;
    dismissed.add(message.number);
    if (Date.now() / 1e3 - message.time < 30 || message.kind === "error") tell(message.text, message.kind);
  }
  showTasks();
  if (state.recordings_version !== listed) { listed = state.recordings_version; listRecordings(); }
}

const LABELS = { frequency: ["Drive frequency [Hz]", "any"], amplitude: ["Drive amplitude [N]", "any"] };
const BUTTONS = { cut: ["Cut the cable", "danger"], hang: ["Hang a new cable", ""] };

function showControls(source) {
  const names = Object.keys(source.controls || {}), key = `${source.number}:${names.join()}:${source.state}`;
  const box = $("rig-controls");
  if (box.dataset.key === key) return;
  box.dataset.key = key;
  const running = source.state === "running", made = [];
  const buttons = names.filter((name) => BUTTONS[name]).map((name) => element("button", { type: "button", id: `control-${name}`, class: BUTTONS[name][1], disabled: !running, onclick: () => press("control", { name, value: 1 }) }, BUTTONS[name][0]));
  if (buttons.length) made.push(element("div", { class: "row" }, ...buttons));
  for (const name of names.filter((item) => !BUTTONS[item])) {
    const input = element("input", { id: `control-${name}`, inputmode: "decimal", autocomplete: "off", value: source.controls[name] ?? "" });
    made.push(element("form", { class: "row", onsubmit: (event) => { event.preventDefault(); press("control", { name, value: Number(input.value.replace(",", ".")) }); } },
      element("label", { class: "grow" }, LABELS[name]?.[0] || name, input), element("button", { type: "submit", disabled: !running }, "Set")));
  }
  if (source.rig === "vibration") made.push(element("div", { class: "row" }, element("button", { type: "button", id: "sweep", disabled: !running, onclick: () => press("sweep") }, "Stepped-sine run"), element("span", { class: "hint", id: "sweep-line" })));
  if (!running && source.state !== "starting") made.push(element("div", { class: "row" }, element("button", { type: "button", id: "restart", class: "primary", onclick: () => press("restart") }, "Start the source again")));
  box.replaceChildren(...made);
}

// ---- recordings and tasks

async function listRecordings() {
  const answer = await fetch("/api/recordings").then((found) => found.json()).catch(() => []);
  if (!Array.isArray(answer)) { tell(answer.error, "error"); return; }
  const size = (bytes) => (bytes > 1e6 ? `${number(bytes / 1e6, 3)} MB` : `${number(bytes / 1e3, 3)} kB`);
  const row = (item) => {
    const button = (text, what, extra = {}) => element("button", { type: "button", ...extra, onclick: what }, text);
    const buttons = [button("Info", () => run("info", item.name)), button("Identify release", () => run("decay", item.name)), button("Identify rig", () => run("rig", item.name)),
      button("Force", () => run("force", item.name)), ...(item.identified ? [button("Use its dynamics live", () => press("use", { recording: item.name }))] : []), ...item.reports.map((name) => button(name.endsWith("-force.html") ? "Force report" : "Identification report", () => showReport(name)))];
    return element("tr", { "data-name": item.name }, element("td", {}, element("a", { href: `/file/${encodeURIComponent(item.name)}`, download: item.name }, item.name)), element("td", { class: "n" }, size(item.size)),
      element("td", {}, new Date(item.changed * 1e3).toLocaleString()), element("td", {}, element("div", { class: "row" }, ...buttons)));
  };
  $("recordings").replaceChildren(answer.length ? element("div", { class: "wide" }, element("table", {}, element("thead", {}, element("tr", {}, element("th", {}, "Name"), element("th", { class: "n" }, "Size"), element("th", {}, "Changed"), element("th", {}, "")))
    , element("tbody", {}, ...answer.map(row)))) : element("p", { class: "hint" }, "No recordings yet."));
  if (!$("record-name").value || answer.some((item) => item.name === `${$("record-name").value}.h5`)) suggest(answer.map((item) => item.name));
}

function suggest(names) { let k = 1; while (names.includes(`run-${String(k).padStart(3, "0")}.h5`)) k++; $("record-name").value = `run-${String(k).padStart(3, "0")}`; }

const wanted = new Set();

async function run(verb, recording) {
  const body = { verb, recording };
  if (verb === "decay" || verb === "rig") {
    body.component = component || "AF";
    const mass = panel?.masses?.[body.component];
    if (mass) body.mass = String(mass);
    else if (verb === "decay") {
      const given = window.prompt(`Moving mass behind ${body.component} [kg]`);
      if (!given) return;
      body.mass = given.replace(",", ".");
    }
  }
  const found = await press("job", body);
  if (found.number) { wanted.add(found.number); showTasks(); }
}

const VERBS = { info: "Info", decay: "Identification", rig: "Identification", force: "Force" };

function showTasks() {
  if (!state) return;
  const busy = state.tasks.filter((task) => task.state === "waiting" || task.state === "running");
  $("tasks").replaceChildren(...busy.map((task) => element("p", { class: "hint" }, `${VERBS[task.verb]} of ${task.recording}: ${task.state === "running" ? "under way…" : "waiting"} `, element("button", { type: "button", onclick: () => press("cancel") }, "End it"))));
  for (const task of state.tasks) {
    if (!wanted.has(task.number) || task.state === "waiting" || task.state === "running") continue;
    wanted.delete(task.number);
    if (task.state === "done") showResult(task);
  }
  const sweep = $("sweep-line");
  if (sweep) { sweep.textContent = state.sweep ? state.sweep.text : ""; $("sweep").disabled = Boolean(state.sweep?.running) || state.source.state !== "running"; }
  if (state.sweep?.task && !counters.swept?.includes(state.sweep.task)) { counters.swept = [...(counters.swept || []), state.sweep.task]; wanted.add(state.sweep.task); }
}

async function showResult(task) {
  if (task.report) { showReport(task.report); return; }
  const found = await fetch(`/api/task/${task.number}`).then((answer) => answer.json()).catch(() => null);
  if (!found?.account) return;
  const { account } = found;
  $("result").hidden = false; $("report").hidden = true; $("result-title").textContent = `${account.file}: ${number(account.duration, 5)} s at ${number(account.rate, 6)} Hz, ${account.samples} samples`;
  const cell = (value) => element("td", { class: "n" }, value);
  $("result-table").replaceChildren(element("div", { class: "wide" }, element("table", {}, element("thead", {}, element("tr", {}, ...["Channel", "Unit", "Least", "Mean", "Largest", "Noise", "Missing", "Saturated"].map((name, k) => element("th", { class: k > 1 ? "n" : "" }, name)))),
    element("tbody", {}, ...Object.entries(account.channels).map(([name, item]) => element("tr", {}, element("td", {}, name), element("td", {}, item.si_unit), cell(number(item.least)), cell(number(item.mean)), cell(number(item.largest)), cell(number(item.noise, 3)), cell(String(item.missing)), cell(String(item.saturated))))))),
    element("p", { class: "hint" }, account.gaps.length ? `Gaps: ${account.gaps.map((gap) => `${number(gap.length, 4)} s at ${number(gap.start, 5)} s`).join("; ")}` : "No gaps."), ...account.warnings.map((text) => element("p", { class: "warn" }, `▲ ${text}`)));
  $("result").scrollIntoView({ block: "nearest" });
}

function showReport(name) {
  $("result").hidden = false; $("result-table").replaceChildren(); $("report").hidden = false; $("result-title").textContent = name; $("report").src = `/report/${encodeURIComponent(name)}?${Date.now()}`;
  $("result").scrollIntoView({ block: "start" });
}

// ---- what can be pressed

$("window").addEventListener("change", () => {
  seconds = Number($("window").value);
  const wish = seconds <= 2 ? 0 : seconds <= 60 ? 1 : 2;
  scales.clear();
  if (wish !== level) { level = wish; if (panel) makeRings(); send({ level }); }
  dirty = true; draw();
});
$("pause").addEventListener("click", () => {
  paused = !paused;
  if (panel) frozen = newestTick / (panel.width * STEP ** level);
  $("pause").setAttribute("aria-pressed", String(paused)); $("pause").textContent = paused ? "Go on" : "Pause";
});
$("waterfall-of").addEventListener("change", drawSpectra);
$("rig").addEventListener("change", async () => { if ($("rig").value) await press("rig", { rig: $("rig").value }); $("rig").blur(); });
$("zero").addEventListener("click", () => press("zero"));
$("clear-zero").addEventListener("click", () => press("clear_zero"));
$("mark-form").addEventListener("submit", (event) => { event.preventDefault(); press("mark", { text: $("mark").value }); $("mark").value = ""; });
$("record-form").addEventListener("submit", (event) => {
  event.preventDefault();
  const text = $("record-seconds").value.trim().replace(",", ".");
  press("record", { name: $("record-name").value, notes: $("record-notes").value, seconds: text ? Number(text) : null });
});
$("stop").addEventListener("click", () => press("stop"));
$("trigger").addEventListener("click", () => press("trigger"));
$("close-result").addEventListener("click", () => { $("result").hidden = true; $("report").removeAttribute("src"); });
$("open-setup").addEventListener("click", () => openSetup());
$("theme").addEventListener("click", () => {
  const dark = document.documentElement.dataset.theme ? document.documentElement.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  document.documentElement.dataset.theme = dark ? "light" : "dark";
  try { localStorage.setItem("theme", document.documentElement.dataset.theme); } catch { /* not kept, then */ }
  dirty = true; draw(); drawSpectra();
});
try { const kept = localStorage.getItem("theme"); if (kept === "light" || kept === "dark") document.documentElement.dataset.theme = kept; } catch { /* none kept */ }
addEventListener("resize", () => { dirty = true; draw(); drawSpectra(); });
document.addEventListener("visibilitychange", () => { dirty = true; draw(); });

connect();

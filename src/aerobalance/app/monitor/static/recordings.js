// The recordings of the project folder, what is done with them, and its results in place.

import { number } from "./charts.js";
import { $, button, element, press, tell, typed } from "./dom.js";
import { page } from "./shown.js";

const VERBS = {
  info: "Info",
  decay: "Identification",
  rig: "Identification",
  force: "Force",
  together: "Identification",
};
const OVER = ["done", "failed"];

const wanted = new Set(),
  swept = new Set(),
  chosen = new Set(); // recordings that are identified together
let listed = -1;

export function showTasks() {
  const { tasks, sweep, source, recordings_version: version } = page.state;
  const busy = tasks.filter((task) => !OVER.includes(task.state));
  $("tasks").replaceChildren(
    ...busy.map((task) =>
      element(
        "p",
        { class: "hint" },
        `${VERBS[task.verb]} of ${task.recording}: ${task.state === "running" ? "under way…" : "waiting"} `,
        button("End it", () => press("cancel")),
      ),
    ),
  );
  if (sweep?.task && !swept.has(sweep.task)) {
    swept.add(sweep.task);
    wanted.add(sweep.task);
  }
  for (const task of tasks) {
    if (!wanted.has(task.number) || !OVER.includes(task.state)) continue;
    wanted.delete(task.number);
    if (task.state === "done") showResult(task);
  }
  if ($("sweep")) {
    $("sweep-line").textContent = sweep ? sweep.text : "";
    $("sweep").disabled = Boolean(sweep?.running) || source.state !== "running";
  }
  if (version !== listed) {
    listed = version;
    listRecordings();
  }
}

async function listRecordings() {
  const answer = await fetch("/api/recordings")
    .then((found) => found.json())
    .catch(() => []);
  if (!Array.isArray(answer)) {
    tell(answer.error, "error");
    return;
  }
  const head = ["Name", "Size", "Changed", "", "Made of it"].map((text, k) => element("th", { class: k === 1 ? "n" : "" }, text));
  const table = element(
    "table",
    {},
    element("thead", {}, element("tr", {}, ...head)),
    element("tbody", {}, ...answer.map(rowOf)),
  );
  const none = element("p", { class: "hint" }, "No recordings yet: give a name under Record, and press it.");
  for (const name of chosen) if (!answer.some((item) => item.name === name)) chosen.delete(name);
  $("recordings").replaceChildren(answer.length ? element("div", { class: "wide" }, table) : none);
  if (answer.length && page.panel?.components.length > 1)
    $("recordings").append(button("Identify the chosen releases together", together));
  const names = answer.map((item) => item.name),
    own = $("record-name");
  if (!own.value || names.includes(`${own.value}.h5`)) own.value = freeName(names);
}

function rowOf(item) {
  const verbs = [
    ["Info", "info"],
    ["Identify release", "decay"],
    ["Identify rig", "rig"],
    ["Force", "force"],
  ].map(([text, verb]) => button(text, () => run(verb, item.name)));
  const live = item.identified ? [button("Use its dynamics live", () => press("use", { recording: item.name }))] : [];
  const reports = item.reports.map((name) =>
    element(
      "li",
      {},
      element(
        "a",
        { href: reportAt(name), target: "_blank", rel: "noopener" },
        name.endsWith("-force.html") ? "Force report" : "Identification report",
      ),
      " ",
      button("Show here", () => showReport(name), { class: "quiet", "aria-label": `Show ${name} here` }),
      " ",
      download(name, "Save"),
    ),
  );
  const files = item.files.map((name) => element("li", {}, download(name, name)));
  const size = item.size > 1e6 ? `${number(item.size / 1e6, 3)} MB` : `${number(item.size / 1e3, 3)} kB`;
  return element(
    "tr",
    { "data-name": item.name },
    element(
      "td",
      {},
      choice(item.name),
      download(item.name, item.name),
    ),
    element("td", { class: "n" }, size),
    element("td", {}, new Date(item.changed * 1e3).toLocaleString()),
    element("td", {}, element("div", { class: "row" }, ...verbs, ...live)),
    element("td", {}, element("ul", { class: "files" }, ...reports, ...files)),
  );
}

const reportAt = (name) => `/report/${encodeURIComponent(name)}`;

const download = (name, text) =>
  element("a", { href: `/file/${encodeURIComponent(name)}`, download: name, "aria-label": `Save ${name}` }, text);

function choice(name) {
  const box = element("input", { type: "checkbox", class: "choose", "aria-label": `choose ${name}` });
  box.checked = chosen.has(name);
  box.addEventListener("change", () => (box.checked ? chosen.add(name) : chosen.delete(name)));
  return box;
}

// Inertia and damping of all coupled components; written beside the first of the recordings.
async function together() {
  const [recording, ...others] = [...chosen].sort();
  if (!recording) {
    tell("choose the recordings of releases first", "error");
    return;
  }
  await begin({ verb: "together", recording, others });
}

function freeName(names) {
  let k = 1;
  while (names.includes(`run-${String(k).padStart(3, "0")}.h5`)) k++;
  return `run-${String(k).padStart(3, "0")}`;
}

async function run(verb, recording) {
  const body = { verb, recording };
  if (verb === "decay" || verb === "rig") {
    body.component = page.component || "AF";
    const mass = page.panel?.masses?.[body.component];
    if (mass) body.mass = String(mass);
    else if (verb === "decay") {
      const given = await askMass(body.component);
      if (given === null) return;
      body.mass = String(given);
    }
  }
  await begin(body);
}

async function begin(body) {
  const found = await press("job", body);
  if (found.number) {
    wanted.add(found.number);
    showTasks();
  }
}

// A dialog of the page's own: null where it was called off.
function askMass(component) {
  const dialog = $("ask-mass"),
    input = $("mass-value");
  $("mass-of").textContent = component;
  $("mass-error").hidden = true;
  dialog.showModal();
  input.select();
  return new Promise((resolve) => {
    dialog.onclose = () => resolve(null);
    $("mass-form").onsubmit = (event) => {
      event.preventDefault();
      const mass = typed(input.value);
      $("mass-error").hidden = mass > 0;
      if (mass > 0) {
        resolve(mass);
        dialog.close();
      }
    };
    $("mass-cancel").onclick = () => dialog.close();
  });
}

async function showResult(task) {
  if (task.report) {
    showReport(task.report);
    return;
  }
  const found = await fetch(`/api/task/${task.number}`)
    .then((answer) => answer.json())
    .catch(() => null);
  if (!found?.account) return;
  const { account } = found;
  if (task.verb === "together") {
    showModes(task, account);
    return;
  }
  open(
    `${account.file}: ${number(account.duration, 5)} s at ${number(account.rate, 6)} Hz, ${account.samples} samples`,
  );
  const cell = (value) => element("td", { class: "n" }, value);
  const head = ["Channel", "Unit", "Least", "Mean", "Largest", "Noise", "Missing", "Saturated"].map((name, k) =>
    element("th", { class: k > 1 ? "n" : "" }, name),
  );
  const body = Object.entries(account.channels).map(([name, item]) =>
    element(
      "tr",
      {},
      element("td", {}, name),
      element("td", {}, item.unit),
      cell(number(item.least)),
      cell(number(item.mean)),
      cell(number(item.largest)),
      cell(number(item.noise, 3)),
      cell(String(item.missing)),
      cell(String(item.saturated)),
    ),
  );
  const gaps = account.gaps.map((gap) => `${number(gap.length, 4)} s at ${number(gap.start, 5)} s`);
  $("result-table").replaceChildren(
    element(
      "div",
      { class: "wide" },
      element("table", {}, element("thead", {}, element("tr", {}, ...head)), element("tbody", {}, ...body)),
    ),
    element("p", { class: "hint" }, gaps.length ? `Gaps: ${gaps.join("; ")}` : "No gaps."),
    ...account.warnings.map((text) => element("p", { class: "warn" }, `▲ ${text}`)),
  );
  $("result").scrollIntoView({ block: "nearest" });
}

function showModes(task, account) {
  open(`${task.recording}: coupled components; ${task.files.join(", ")}`);
  const head = ["Mode", "Natural frequency [Hz]", "Damping ratio [%]"].map((name) =>
    element("th", { class: "n" }, name),
  );
  const body = account.modes.map((mode, k) =>
    element(
      "tr",
      {},
      ...[String(k + 1), number(mode.natural_frequency, 6), number(100 * mode.damping_ratio, 4)].map((value) =>
        element("td", { class: "n" }, value),
      ),
    ),
  );
  $("result-table").replaceChildren(
    element("table", {}, element("thead", {}, element("tr", {}, ...head)), element("tbody", {}, ...body)),
    ...account.warnings.map((text) => element("p", { class: "warn" }, `▲ ${text}`)),
  );
  $("result").scrollIntoView({ block: "nearest" });
}

function showReport(name) {
  open(name);
  $("report").hidden = false;
  $("report").src = `${reportAt(name)}?${Date.now()}`;
  $("report-tab").hidden = false;
  $("report-tab").href = reportAt(name);
  $("result").scrollIntoView({ block: "start" });
}

function open(title) {
  $("result").hidden = false;
  $("report").hidden = $("report-tab").hidden = true;
  $("result-table").replaceChildren();
  $("result-title").textContent = title;
}

export function wireRecordings() {
  $("close-result").addEventListener("click", () => {
    $("result").hidden = true;
    $("report").removeAttribute("src");
  });
}

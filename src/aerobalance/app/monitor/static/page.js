// The operator's page: its connection to the server, and what is set for the page alone.

import { listAlarms, showAlarms, wireAlarms } from "./alarms.js";
import { showCampaign, wireCampaign } from "./campaign.js";
import { showState, wireControls } from "./controls.js";
import { $, button } from "./dom.js";
import { showPause, wireLook } from "./look.js";
import { beginNumbers, showNumbers } from "./numbers.js";
import { showTasks, wireRecordings } from "./recordings.js";
import { openSetup } from "./setup.js";
import { counters, page } from "./shown.js";
import { beginCharts, draw, drawSpectra, forgetSpectra, redraw, takeBins, takeSpectra, view } from "./strips.js";

const KEPT = 2000; // ages of samples that percentiles are drawn from
const OVER = 5000; // time that updates are counted over [ms]
const SILENT = 4000; // time after which a server that says nothing is out of reach [ms]; it answers a ping each second
const STALE = 2000; // age from which on the newest sample of a source that runs is told [ms]

let socket = null,
  offset = 0,
  bestTrip = Infinity,
  heardAt = -Infinity,
  newestMs = null;
const times = [],
  newest = [],
  oldest = [];

const send = (message) => {
  if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
};
const clock = () => performance.timeOrigin + performance.now();
const ping = () => send({ ping: clock() });

function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => {
    heardAt = performance.now();
    page.panel = null;
    bestTrip = Infinity;
    send({ level: view.level, component: page.component });
    for (let k = 0; k < 5; k++) setTimeout(ping, 300 * k);
  };
  socket.onclose = () => {
    heardAt = -Infinity;
    watch();
    setTimeout(connect, 1000);
  };
  socket.onmessage = ({ data }) => {
    heardAt = performance.now();
    if (typeof data === "string") heard(JSON.parse(data));
    else frame(data);
  };
}

const ageText = (ms) => {
  const seconds = Math.max(0, ms) / 1e3;
  if (seconds < 60) return `${seconds.toFixed(0)} s`;
  return seconds < 3600
    ? `${Math.floor(seconds / 60)} min ${Math.floor(seconds % 60)} s`
    : `${(seconds / 3600).toFixed(1)} h`;
};

// Say how old what is shown is, and grey it where it is not of now.
function watch() {
  const lost = performance.now() - heardAt > SILENT || !page.state,
    age = newestMs === null ? null : clock() + offset - newestMs,
    stale = lost || (page.state?.source.state === "running" && age > STALE);
  const changed = lost !== page.lost || stale !== page.stale;
  page.lost = counters.lost = lost;
  page.stale = stale;
  counters.age = age;
  document.body.classList.toggle("lost", lost && newestMs !== null);
  document.body.classList.toggle("stale", stale && newestMs !== null);
  $("lost-connection").hidden = !lost || !page.state;
  $("data-age").hidden = !stale || age === null;
  const text = age === null ? "" : `data are ${ageText(age)} old`;
  if ($("data-age").textContent !== text) $("data-age").textContent = text;
  if (changed) redraw();
  if (changed || page.pressed) {
    showState();
    showAlarms();
  }
}

function heard(message) {
  if (message.type === "state") {
    page.state = message;
    watch();
    showState();
    showAlarms();
    if (!$("alarms").hidden) listAlarms();
    showTasks();
    showCampaign();
  } else if (message.type === "panel") begin(message);
  else if (message.type === "numbers") {
    page.numbers = message;
    page.marks = message.marks;
    showNumbers();
    showAlarms();
  } else if (message.type === "pong") {
    const now = clock(),
      trip = now - message.ping;
    if (trip <= bestTrip) {
      bestTrip = trip;
      offset = message.now - (now + message.ping) / 2;
    }
  }
}

function begin(panel) {
  page.panel = panel;
  page.numbers = {};
  newest.length = oldest.length = 0;
  if (!panel.components.includes(page.component)) page.component = panel.components[0] || "";
  const tabs = panel.components.length > 1 ? panel.components : [];
  $("components").replaceChildren(
    ...tabs.map((name) => button(name, () => choose(name), { "aria-pressed": String(name === page.component) })),
  );
  newestMs = null;
  beginCharts();
  showPause();
  beginNumbers();
  send({ level: view.level, component: page.component });
}

function choose(name) {
  page.component = name;
  for (const tab of $("components").children) tab.setAttribute("aria-pressed", String(tab.textContent === name));
  send({ component: name });
  forgetSpectra();
}

function frame(buffer) {
  const bytes = new DataView(buffer),
    sequence = bytes.getUint32(4, true);
  if (bytes.getUint8(0) === 2) {
    takeSpectra(bytes, buffer);
    send({ shown: sequence });
    return;
  }
  takeBins(bytes, buffer);
  const fresh = bytes.getFloat64(16, true),
    old = bytes.getFloat64(24, true);
  newestMs = fresh;
  requestAnimationFrame(() => {
    draw();
    const now = clock();
    if (fresh - old < 1000) {
      keep(newest, now + offset - fresh);
      keep(oldest, now + offset - old);
    }
    times.push(now);
    counters.frames += 1;
    send({ shown: sequence });
  });
}

function keep(list, value) {
  list.push(value);
  if (list.length > KEPT) list.shift();
}

function part(list, share) {
  const sorted = [...list].sort((a, b) => a - b);
  return sorted.length ? sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))] : null;
}

setInterval(() => {
  while (times.length && clock() - times[0] > OVER) times.shift();
  counters.updates = times.length / (OVER / 1000);
  counters.latency = {
    newest: { p50: part(newest, 0.5), p95: part(newest, 0.95) },
    oldest: { p50: part(oldest, 0.5), p95: part(oldest, 0.95) },
  };
}, 500);
setInterval(() => {
  bestTrip *= 1.04;
  ping();
}, 1000);
setInterval(watch, 250);

// ---- what is set for the page alone

const root = document.documentElement;

function theme(wish) {
  if (wish === "light" || wish === "dark") root.dataset.theme = wish;
}

$("theme").addEventListener("click", () => {
  const dark =
    (root.dataset.theme || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light")) === "dark";
  theme(dark ? "light" : "dark");
  try {
    localStorage.setItem("theme", root.dataset.theme);
  } catch {
    /* not kept, then */
  }
  redraw();
});
try {
  theme(localStorage.getItem("theme"));
} catch {
  /* none kept */
}

$("waterfall-of").addEventListener("change", drawSpectra);
$("open-setup").addEventListener("click", openSetup);
addEventListener("resize", redraw);
document.addEventListener("visibilitychange", redraw);
wireControls(() => (bestTrip === Infinity ? null : clock() + offset));
wireAlarms();
wireLook(send);
wireRecordings();
wireCampaign();
connect();

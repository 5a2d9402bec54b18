// The operator's page: its connection to the server, and what is set for the page alone.

import { showState, wireControls } from "./controls.js";
import { $, button } from "./dom.js";
import { beginNumbers, showNumbers } from "./numbers.js";
import { showTasks, wireRecordings } from "./recordings.js";
import { openSetup } from "./setup.js";
import { counters, page } from "./shown.js";
import {
  beginCharts,
  chooseWindow,
  draw,
  drawSpectra,
  forgetSpectra,
  pause,
  redraw,
  takeBins,
  takeSpectra,
  view,
} from "./strips.js";

const KEPT = 2000; // ages of samples that percentiles are drawn from
const OVER = 5000; // time that updates are counted over [ms]

let socket = null,
  offset = 0,
  bestTrip = Infinity;
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
    $("lost-connection").hidden = true;
    page.panel = null;
    bestTrip = Infinity;
    send({ level: view.level, component: page.component });
    for (let k = 0; k < 5; k++) setTimeout(ping, 300 * k);
  };
  socket.onclose = () => {
    $("lost-connection").hidden = false;
    setTimeout(connect, 1000);
  };
  socket.onmessage = ({ data }) => (typeof data === "string" ? heard(JSON.parse(data)) : frame(data));
}

function heard(message) {
  if (message.type === "state") {
    page.state = message;
    showState();
    showTasks();
  } else if (message.type === "panel") begin(message);
  else if (message.type === "numbers") {
    page.numbers = message;
    page.marks = message.marks;
    showNumbers();
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
  beginCharts();
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
  bestTrip *= 1.2;
  ping();
}, 5000);

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

$("window").addEventListener("change", () => {
  if (chooseWindow(Number($("window").value))) send({ level: view.level });
});
$("pause").addEventListener("click", () => {
  pause(!view.paused);
  $("pause").setAttribute("aria-pressed", String(view.paused));
  $("pause").textContent = view.paused ? "Go on" : "Pause";
});
$("waterfall-of").addEventListener("change", drawSpectra);
$("open-setup").addEventListener("click", openSetup);
addEventListener("resize", redraw);
document.addEventListener("visibilitychange", redraw);
wireControls();
wireRecordings();
connect();

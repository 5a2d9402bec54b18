// Looking into the charts: a cursor with its values, zoom, and what was before; with mouse, finger or keyboard.

import { plotOf } from "./charts.js";
import { $ } from "./dom.js";
import { page } from "./shown.js";
import { chooseWindow, hold, later, live, lock, look, looksBack, scroll, select, view, zoom } from "./strips.js";

const MEANT = 8; // way that a drag must go to be one [pixels]
const CLOSER = 0.7; // factor of a step of zoom

let from = null, // where a drag began, as a part of the width
  send = () => {};

// The part of the plot's width at a pointer; null beside it.
function partAt(canvas, event) {
  const plot = plotOf(canvas, canvas.id === "main-chart"),
    part = (event.clientX - canvas.getBoundingClientRect().left - plot.left) / plot.width;
  return part >= -0.02 && part <= 1.02 ? Math.min(1, Math.max(0, part)) : null;
}

const chartAt = (event) => event.target.closest("#main-chart, #channels canvas");

export function showPause() {
  const back = looksBack();
  $("pause").setAttribute("aria-pressed", String(back));
  $("pause").textContent = back ? "Go on" : "Pause";
}

// Do something to what is looked at, and say on the button whether that is still live.
function looking(what) {
  what();
  showPause();
}

export function goOn() {
  live();
  if (chooseWindow(Number($("window").value))) send({ level: view.level });
  showPause();
}

function pointed(event) {
  const canvas = chartAt(event);
  if (!canvas) return;
  const part = partAt(canvas, event);
  if (from !== null && part !== null) view.selection = [Math.min(from, part), Math.max(from, part)];
  view.cursor = part;
  later();
}

function pressed(event) {
  const canvas = chartAt(event);
  if (!canvas || event.button) return;
  from = partAt(canvas, event);
  if (from !== null) canvas.setPointerCapture(event.pointerId);
}

function released(event) {
  const canvas = chartAt(event),
    { selection } = view;
  from = view.selection = null;
  later();
  if (!canvas || !selection) return;
  const wide = (selection[1] - selection[0]) * plotOf(canvas, canvas.id === "main-chart").width;
  if (wide >= MEANT) looking(() => select(selection));
}

function left() {
  from = view.cursor = view.selection = null;
  later();
}

function wheeled(event) {
  const canvas = chartAt(event);
  if (!canvas || !(event.ctrlKey || event.metaKey || event.shiftKey)) return; // else the page scrolls, as it should
  event.preventDefault();
  const way = event.deltaY || event.deltaX;
  if (event.shiftKey) looking(() => scroll(way > 0 ? 0.15 : -0.15));
  else looking(() => zoom(way > 0 ? 1 / CLOSER : CLOSER, partAt(canvas, event) ?? 0.5));
}

const move = (by) => {
  view.cursor = Math.min(1, Math.max(0, (view.cursor ?? 1) + by));
  later();
};
const KEYS = {
  ArrowLeft: (far) => move(far ? -0.1 : -0.01),
  ArrowRight: (far) => move(far ? 0.1 : 0.01),
  "+": () => looking(() => zoom(CLOSER, view.cursor ?? 0.5)),
  "-": () => looking(() => zoom(1 / CLOSER, view.cursor ?? 0.5)),
  PageUp: () => looking(() => scroll(-0.5)),
  PageDown: () => looking(() => scroll(0.5)),
  Home: () => looking(() => look(0, view.seconds)),
  End: goOn,
  Escape: left,
};

function typedKey(event) {
  const what = KEYS[event.key];
  if (!what || !page.panel || event.ctrlKey || event.altKey || event.metaKey) return;
  event.preventDefault();
  what(event.shiftKey);
}

export function wireLook(sender) {
  send = sender;
  for (const box of [$("main-chart"), $("channels")]) {
    box.addEventListener("pointermove", pointed);
    box.addEventListener("pointerdown", pressed);
    box.addEventListener("pointerup", released);
    box.addEventListener("pointercancel", left);
    box.addEventListener("pointerleave", left);
    box.addEventListener("wheel", wheeled, { passive: false });
  }
  $("main-chart").addEventListener("keydown", typedKey);
  $("main-chart").addEventListener("focus", () => $("main-chart").matches(":focus-visible") && move(0));
  $("main-chart").addEventListener("blur", left);
  $("pause").addEventListener("click", () => (looksBack() ? goOn() : looking(hold)));
  $("earlier").addEventListener("click", () => looking(() => scroll(-0.5)));
  $("later").addEventListener("click", () => looking(() => scroll(0.5)));
  $("closer").addEventListener("click", () => looking(() => zoom(CLOSER)));
  $("wider").addEventListener("click", () => looking(() => zoom(1 / CLOSER)));
  $("lock").addEventListener("click", () => {
    lock(!view.locked);
    $("lock").setAttribute("aria-pressed", String(view.locked));
  });
  $("window").addEventListener("change", () => {
    if (chooseWindow(Number($("window").value))) send({ level: view.level });
    later();
  });
}

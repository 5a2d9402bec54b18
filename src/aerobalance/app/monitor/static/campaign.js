// A test that is watched: its runs are reduced as they come in, and join the page of results.

import { $, element, press } from "./dom.js";
import { page } from "./shown.js";

const LAST = 4; // words on runs that are shown
const PAGE = "/campaign/summary.html";

let shown = 0, // version of the results in the frame
  own = 0, // pages that this file has put into the frame
  loaded = 0; // and all that were: more, where the reader has followed a link

const count = (number, what) => `${number} ${what}`;

function line({ state, name, test, runs, reduced, aside, flags, problem }) {
  if (state === "failed") return `▲ ${test}: ${problem}`;
  if (state === "none") return "";
  const stands = state === "running" ? "watched" : "no longer watched";
  if (runs === undefined) return `${test}: ${stands}; no run is reduced yet`;
  const more = [aside ? count(aside, "set aside") : "", ...Object.entries(flags)
    .filter(([kind]) => kind !== "set aside")
    .map(([kind, number]) => `▲ ${kind}${number > 1 ? ` (${number})` : ""}`)];
  return [`${name}: ${stands}; ${reduced} of ${runs} runs reduced`, ...more.filter(Boolean)].join(", ");
}

export function showCampaign() {
  const campaign = page.state.campaign,
    running = campaign.state === "running";
  const text = line(campaign);
  if ($("campaign-line").textContent !== text) $("campaign-line").textContent = text;
  $("campaign-line").classList.toggle("error", campaign.state === "failed");
  $("campaign-begin").hidden = running;
  $("campaign-end").hidden = !running;
  $("campaign-test").disabled = running;
  $("campaign-said").replaceChildren(...campaign.said.slice(-LAST).map((said) => element("li", {}, said)));
  const there = campaign.runs !== undefined;
  $("campaign-page").hidden = $("campaign-apart").hidden = !there;
  $("tab-campaign").textContent = there && running ? `Campaign ${campaign.reduced}/${campaign.runs}` : "Campaign";
  if (!there || campaign.version === shown || $("campaign-view").hidden) return;
  // who reads the page of a run keeps it until asked for the new results
  if (loaded > own) $("campaign-new").hidden = false;
  else load(campaign.version);
}

function load(version) {
  shown = version;
  own += 1;
  loaded = own - 1;
  $("campaign-new").hidden = true;
  $("campaign-page").src = `${PAGE}?${version}#polars`;
}

async function listTests() {
  const answer = await fetch("/api/tests")
    .then((found) => found.json())
    .catch(() => []);
  const names = Array.isArray(answer) ? answer : [],
    chosen = page.state?.campaign.test || $("campaign-test").value;
  $("campaign-test").replaceChildren(
    ...names.map((name) => element("option", { value: name, selected: name === chosen }, name)),
  );
  $("campaign-hint").hidden = names.length > 0;
  $("campaign-begin").disabled = !names.length;
}

function choose(campaign) {
  $("live-view").hidden = campaign;
  $("campaign-view").hidden = !campaign;
  $("tab-live").setAttribute("aria-pressed", String(!campaign));
  $("tab-campaign").setAttribute("aria-pressed", String(campaign));
  if (campaign) {
    listTests();
    if (page.state) showCampaign();
  } else dispatchEvent(new Event("resize")); // charts that were hidden had no size
}

export function wireCampaign() {
  $("tab-live").addEventListener("click", () => choose(false));
  $("tab-campaign").addEventListener("click", () => choose(true));
  $("campaign-begin").addEventListener("click", () => press("watch", { test: $("campaign-test").value }));
  $("campaign-end").addEventListener("click", () => press("end_watch"));
  $("campaign-new").addEventListener("click", () => load(page.state.campaign.version));
  $("campaign-page").addEventListener("load", () => {
    loaded += 1;
  });
}

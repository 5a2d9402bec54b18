// The form of the test set-up: made from the fields that the server lists, checked by the server.

import { act, element } from "./page.js";

const $ = (id) => document.getElementById(id);
let form = null;

const number = (text) => { const value = Number(text.trim().replace(",", ".")); return Number.isFinite(value) ? value : text.trim(); };

function fieldOf(field, path, value) {
  const id = `f-${path.replaceAll(".", "-")}`;
  let input;
  if (field.type === "choice") {
    const none = field.default === null || field.default === undefined;
    input = element("select", { id, "data-path": path }, ...(none ? [element("option", { value: "" }, "")] : []), ...field.choices.map((choice) => element("option", { value: String(choice) }, String(choice))));
    input.value = String(value ?? field.default ?? "");
  } else if (field.long) {
    input = element("textarea", { id, "data-path": path, rows: 3 });
    input.value = value ?? "";
  } else {
    input = element("input", { id, "data-path": path, inputmode: field.type === "number" ? "decimal" : null, autocomplete: "off", placeholder: field.default ?? "" });
    input.value = value ?? "";
  }
  input.field = field;
  return element("label", { class: field.long ? "long" : "", for: id }, field.label + (field.unit ? ` [${field.unit}]` : ""), input, ...(field.hint ? [element("span", { class: "hint" }, field.hint)] : []));
}

function group(title, fields, prefix, values, more = []) {
  return element("fieldset", {}, element("legend", {}, title), element("div", { class: "fields" }, ...fields.map((field) => fieldOf(field, prefix ? `${prefix}.${field.key}` : field.key, values?.[field.key]))), ...more);
}

function source(kind) {
  const choice = element("select", { id: "f-source-kind", "data-path": "source.kind" }, ...Object.keys(form.sources).map((name) => element("option", { value: name }, name)));
  choice.value = kind;
  choice.addEventListener("change", () => $("source-group").replaceWith(source(choice.value)));
  const made = group("Source", form.sources[kind], "source", form.values.source?.kind === kind || form.values.kind === kind ? form.values.source : {});
  made.id = "source-group";
  made.querySelector(".fields").prepend(element("label", {}, "Kind", choice));
  return made;
}

function table(title, key, fields, values, names) {
  const box = element("div", {});
  const one = (name, value) => {
    const set = group(name, fields, `${key}.${name}`, value);
    set.dataset.entry = name;
    set.append(element("button", { type: "button", onclick: () => set.remove() }, `Take ${name} out`));
    box.append(set);
  };
  Object.entries(values || {}).forEach(([name, value]) => one(name, value));
  const list = element("datalist", { id: `names-${key}` }, ...names.map((name) => element("option", { value: name })));
  const add = element("input", { "aria-label": `Channel to add to ${title}`, placeholder: "channel", list: `names-${key}`, autocomplete: "off", id: `add-${key}` });
  const button = element("button", { type: "button", id: `add-${key}-button`, onclick: () => { const name = add.value.trim(); if (name && !box.querySelector(`[data-entry="${CSS.escape(name)}"]`)) one(name, {}); add.value = ""; } }, "Add");
  const hint = key === "channels" ? "Where none is listed, all channels of the source are taken under their own names." : "What a channel must not leave.";
  return element("fieldset", {}, element("legend", {}, title), element("p", { class: "hint" }, hint), box, element("div", { class: "row" }, element("div", { class: "grow" }, add), list, button));
}

export async function openSetup() {
  form = await fetch("/api/setup").then((answer) => answer.json());
  const { values } = form, inputs = form.inputs.map((item) => item.name), known = [...new Set([...inputs, ...form.quantities.map((item) => item.name)])];
  $("setup-error").hidden = true;
  $("setup-fields").replaceChildren(
    group("Test", form.general, "", values), source(values.kind), group("Files", form.files, "files", values.files), group("Record", form.record, "record", values.record),
    table("Channels", "channels", form.channel, values.channels, known), table("Limits", "limits", form.limit, values.limits, known));
  $("setup").showModal();
}

function collect() {
  const given = {};
  const entries = (key) => [...$("setup-fields").querySelectorAll("[data-entry]")].filter((item) => item.querySelector(`[data-path^="${key}."]`));
  for (const key of ["channels", "limits"]) for (const item of entries(key)) (given[key] ??= {})[item.dataset.entry] = {};
  for (const input of $("setup-fields").querySelectorAll("[data-path]")) {
    const path = input.dataset.path, text = input.value;
    if (text.trim() === "") continue;
    const { field } = input;
    if (field?.type === "choice" && String(field.default) === text) continue;
    const value = field?.type === "number" ? number(text) : field?.type === "choice" && typeof field.choices[0] === "number" ? Number(text) : text;
    const entry = input.closest("[data-entry]")?.dataset.entry, key = path.split(".")[0];
    let at = given;
    const parts = entry ? [key, entry, path.slice(key.length + entry.length + 2)] : path.split(".");
    for (const part of parts.slice(0, -1)) at = at[part] ??= {};
    at[parts.at(-1)] = value;
  }
  return given;
}

function fault(found) {
  for (const item of $("setup-fields").querySelectorAll(".field-error")) item.remove();
  for (const item of $("setup-fields").querySelectorAll(".invalid")) { item.classList.remove("invalid"); item.removeAttribute("aria-invalid"); }
  $("setup-error").hidden = !found.error;
  $("setup-error").textContent = found.error ? (found.where ? `${found.where}: ${found.error}` : found.error) : "";
  if (!found.where) return;
  const inputs = [...$("setup-fields").querySelectorAll("[data-path]")];
  const input = inputs.find((item) => item.dataset.path === found.where) || inputs.find((item) => item.dataset.path.startsWith(`${found.where}.`) || (found.error || "").startsWith(item.dataset.path));
  if (!input) return;
  input.classList.add("invalid"); input.setAttribute("aria-invalid", "true");
  input.after(element("span", { class: "field-error" }, found.error));
  input.focus(); input.scrollIntoView({ block: "center" });
}

$("setup-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  $("setup-apply").disabled = true;
  const name = $("setup-name").value.trim();
  const found = await act("setup", { setup: collect(), name: name || null });
  $("setup-apply").disabled = false;
  if (found.error) fault(found); else $("setup").close();
});
$("setup-cancel").addEventListener("click", () => $("setup").close());

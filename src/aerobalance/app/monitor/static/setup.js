// The form of the test set-up: made from the fields that the server lists, checked by the server.

import { $, act, button, element, typed } from "./dom.js";

const NAMES = { true: "yes", false: "no" };
const TABLES = {
  channels: [
    "Channels",
    "Where none is listed, all channels of the source are taken under their own names.",
    "channel",
  ],
  limits: ["Limits", "What a channel or a load must not leave.", "channel"],
  stations: [
    "Stations",
    "Loads at one place of the balance, as sums of components: N1 = 0.5 NF + 2.5 PM, say. They count in the load envelope.",
    "name",
  ],
  shunt: ["Shunt", "What the shunt resistor changes a channel by, for the shunt check.", "channel"],
};

let form = null;

function fieldOf(field, path, value) {
  const id = `f-${path.replaceAll(".", "-")}`,
    input = inputOf(field, { id, "data-path": path }, value);
  input.field = field;
  const label = field.label + (field.unit ? ` [${field.unit}]` : ""),
    words = [field.needed ? "needed" : "", field.hint].filter(Boolean).join("; "),
    hint = words ? [element("span", { class: "hint" }, words)] : [];
  if (field.needed) input.setAttribute("aria-required", "true");
  return element("label", { class: field.long ? "long" : "", for: id }, label, input, ...hint);
}

function inputOf(field, attributes, value) {
  if (field.type === "choice") {
    const none = field.default === null || field.default === undefined ? [""] : [];
    const input = element(
      "select",
      attributes,
      ...[...none, ...field.choices].map((choice) => element("option", { value: String(choice) }, NAMES[choice] ?? String(choice)),
      ),
    );
    input.value = String(value ?? field.default ?? "");
    return input;
  }
  const numeric = field.type === "number";
  const input = field.long
    ? element("textarea", { ...attributes, rows: 3 })
    : element("input", {
        ...attributes,
        inputmode: numeric ? "decimal" : null,
        autocomplete: "off",
        placeholder: field.default ?? "",
      });
  input.value = shownAs(field, value);
  return input;
}

function shownAs(field, value) {
  if (value === null || value === undefined) return "";
  if (field.type === "numbers" && Array.isArray(value)) return value.join(" ");
  return typeof value === "object" ? JSON.stringify(value) : value;
}

function group(title, fields, prefix, values) {
  const plain = fields
    .filter((field) => field.type !== "table")
    .map((field) => fieldOf(field, prefix ? `${prefix}.${field.key}` : field.key, values?.[field.key]));
  return element("fieldset", {}, element("legend", {}, title), element("div", { class: "fields" }, ...plain));
}

function sourceGroup(kind) {
  const choice = element(
    "select",
    { id: "f-source-kind", "data-path": "source.kind" },
    ...Object.keys(form.sources).map((name) => element("option", { value: name }, name)),
  );
  choice.value = kind;
  choice.addEventListener("change", () => $("source-group").replaceWith(sourceGroup(choice.value)));
  const values = form.values.kind === kind ? form.values.source : {},
    made = group("Source", form.sources[kind], "source", values);
  made.id = "source-group";
  made.querySelector(".fields").prepend(element("label", {}, "Kind", choice));
  for (const field of form.sources[kind].filter(({ type }) => type === "table")) {
    made.append(table(`source.${field.key}`, [field.label, field.hint, "name"], field.fields, values?.[field.key]));
  }
  return made;
}

// A table of tables: one set of fields for each name, which can be added and taken out.
function table(key, [title, hint, what], fields, values, names = []) {
  const id = key.replaceAll(".", "-"),
    box = element("div");
  const one = (name, value) => {
    const set = group(name, fields, `${key}.${name}`, value);
    set.dataset.table = key;
    set.dataset.entry = name;
    set.append(button(`Take ${name} out`, () => set.remove()));
    box.append(set);
  };
  for (const [name, value] of Object.entries(values || {})) one(name, value);
  const list = element("datalist", { id: `names-${id}` }, ...names.map((name) => element("option", { value: name })));
  const add = element("input", {
    "aria-label": `${title}: ${what} to add`,
    placeholder: what,
    list: `names-${id}`,
    autocomplete: "off",
    id: `add-${id}`,
  });
  const put = () => {
    const name = add.value.trim();
    if (name && !box.querySelector(`[data-entry="${CSS.escape(name)}"]`)) one(name, {});
    add.value = "";
  };
  add.addEventListener("keydown", (event) => {
    if (event.key === "Enter") {
      event.preventDefault();
      put();
    }
  });
  const row = element(
    "div",
    { class: "row" },
    element("div", { class: "grow" }, add),
    list,
    button("Add", put, { id: `add-${id}-button`, "aria-label": `Add ${what} to ${title}` }),
  );
  return element("fieldset", {}, element("legend", {}, title), element("p", { class: "hint" }, hint), box, row);
}

export async function openSetup() {
  form = await fetch("/api/setup").then((answer) => answer.json());
  const { values } = form,
    known = [...new Set([...form.inputs, ...form.quantities].map((item) => item.name))];
  const tables = Object.entries(form.tables).map(([key, fields]) =>
    table(key, TABLES[key], fields, values[key], key === "stations" ? [] : known),
  );
  $("setup-error").hidden = true;
  $("setup-fields").replaceChildren(
    group("Test", form.general, "", values),
    sourceGroup(values.kind),
    group("Files", form.files, "files", values.files),
    group("Record", form.record, "record", values.record),
    ...tables,
    group("Load envelope", form.envelope, "envelope", values.envelope),
    group("Fouling", form.fouling, "fouling", values.fouling),
  );
  $("setup").showModal();
}

function placeOf(input) {
  const entry = input.closest("[data-entry]");
  return entry
    ? [...entry.dataset.table.split("."), entry.dataset.entry, input.field.key]
    : input.dataset.path.split(".");
}

function at(tree, path) {
  for (const key of path) tree = tree[key] ??= {};
  return tree;
}

// What does not read as its type is sent as it is: the server says what is wrong with it.
function valueOf({ field, value: text }) {
  if (field?.type === "choice") return field.choices.find((choice) => String(choice) === text) ?? text;
  if (field?.type === "number") return Number.isFinite(typed(text)) ? typed(text) : text;
  if (field?.type === "numbers") {
    const parts = text
      .trim()
      .split(/[\s;]+/)
      .map(typed);
    return parts.every(Number.isFinite) ? parts : text;
  }
  if (field?.type === "data") {
    try {
      return JSON.parse(text);
    } catch {
      return text;
    }
  }
  return text;
}

function collect() {
  const given = {},
    fields = $("setup-fields");
  for (const set of fields.querySelectorAll("[data-entry]"))
    at(given, [...set.dataset.table.split("."), set.dataset.entry]);
  for (const input of fields.querySelectorAll("[data-path]")) {
    const usual = input.field?.type === "choice" && String(input.field.default) === input.value;
    if (usual || input.value.trim() === "") continue;
    const path = placeOf(input);
    at(given, path.slice(0, -1))[path.at(-1)] = valueOf(input);
  }
  return given;
}

function showFault(found) {
  const fields = $("setup-fields");
  for (const item of fields.querySelectorAll(".field-error")) item.remove();
  for (const item of fields.querySelectorAll(".invalid")) {
    item.classList.remove("invalid");
    item.removeAttribute("aria-invalid");
  }
  $("setup-error").hidden = !found.error;
  $("setup-error").textContent = found.where ? `${found.where}: ${found.error}` : found.error || "";
  const inputs = [...fields.querySelectorAll("[data-path]")],
    where = found.where || (found.error || "").split(":")[0];
  const input =
    inputs.find((item) => item.dataset.path === where) ||
    inputs.find((item) => item.dataset.path.startsWith(`${where}.`));
  if (!input || !where) return;
  input.classList.add("invalid");
  input.setAttribute("aria-invalid", "true");
  input.after(element("span", { class: "field-error" }, found.error));
  input.focus();
  input.scrollIntoView({ block: "center" });
}

$("setup-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  $("setup-apply").disabled = true;
  const found = await act("setup", { setup: collect(), name: $("setup-name").value.trim() || null });
  $("setup-apply").disabled = false;
  if (found.error) showFault(found);
  else $("setup").close();
});
$("setup-cancel").addEventListener("click", () => $("setup").close());

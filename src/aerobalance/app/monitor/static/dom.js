// Elements, messages, and what is asked of the server.

export const $ = (id) => document.getElementById(id);

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

export const button = (text, what, attributes = {}) =>
  element("button", { type: "button", onclick: what, ...attributes }, text);

export function tell(text, kind = "info") {
  const dismiss = button("×", () => made.remove(), { "aria-label": "Dismiss" });
  const made = element("p", { class: kind }, element("span", {}, text), dismiss);
  $("messages").prepend(made);
  while ($("messages").children.length > 3) $("messages").lastChild.remove();
  if (kind !== "error") setTimeout(() => made.remove(), 8000);
}

// Ask for an action; the answer has `error`, and `where` it lies, if it was refused.
export async function act(action, body = {}) {
  let answer;
  try {
    answer = await fetch(`/api/${action}`, {
      method: "POST",
      headers: { "content-type": "application/json" },
      body: JSON.stringify(body),
    });
  } catch {
    return { error: "the server does not answer" };
  }
  const found = await answer.json().catch(() => ({ error: `the server answers with ${answer.status}` }));
  return answer.ok ? found : { error: found.error || `refused (${answer.status})`, where: found.where };
}

export async function press(action, body = {}) {
  const found = await act(action, body);
  if (found.error) tell(found.error, "error");
  return found;
}

export const typed = (text) => Number(text.trim().replace(",", ".").replace("−", "-"));

// What the parts of the page that prompt a driver share: orders, and lists that change while they are read out.

import { element } from "./tiles.js";

export const byId = (id) => document.getElementById(id);

// "" where it was taken, else why not.
export async function order(path, kind) {
  try {
    const answer = await fetch(path, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ kind }) });
    return (await answer.json()).text;
  } catch {
    return "the server of this page does not answer";
  }
}

// Only what changed: a line that is read out stays where it is. rows: [line, whether a condition is met].
export function list(id, rows) {
  const list = byId(id);
  if (rows.map(([line]) => line).join("\n") === [...list.children].map((item) => item.textContent).join("\n")) return;
  list.replaceChildren(...rows.map(([line, met]) => {
    const item = element("li", "", line);
    if (met !== undefined) item.dataset.met = String(met);
    return item;
  }));
}

// The end of a demo: truth beside estimate, and what to do next.

import { element } from "./tiles.js";
import { known, PARAMETERS } from "./words.js";

const byId = (id) => document.getElementById(id);

export class Over {
  // over: what the demo gave; absent while it drives.
  show(over) {
    byId("over").hidden = !over;
    if (!over || over === this.over) return;
    this.over = over;
    byId("over-table").hidden = !over.rows.length;
    byId("over-rows").replaceChildren(...over.rows.map(row));
    byId("over-next").replaceChildren(...over.next.map(([what, command]) => {
      const item = element("li", "", `${what}: `);
      item.append(element("code", "", command));
      return item;
    }));
  }
}

function row({ name, unit, truth, value, interval, holds }) {
  const which = PARAMETERS.find((one) => one.name === name), line = element("tr");
  const number = (one) => (known(one) ? one.toFixed(which.digits) : "–");
  const head = element("th", "", which.title);
  head.scope = "row";
  head.append(element("span", "quiet", ` ${name}, ${unit}`));
  const range = interval ? `${number(interval[0])} to ${number(interval[1])}` : "–";
  const told = holds === null ? "not estimated" : holds ? "✔ yes" : "✘ no";
  line.append(head, ...[number(truth), number(value), range, told].map((text) => element("td", "", text)));
  return line;
}

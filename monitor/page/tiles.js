// The five sensor tiles: made once, then only their words change.

import { t, word } from "./language.js";
import { capital, known, spaced, time } from "./words.js";

const MOUNTS = ["tractor_front", "tractor_rear", "implement_front", "implement_rear", ""];
const WORDS = { alive: "✔ alive", lost: "✘ LOST", no_data: "✘ NO DATA", waiting: "… waiting" };
const STATES = { alive: "good", lost: "bad", no_data: "bad", waiting: "warn" };
const GOOD_FIXES = new Set(["rtk_fixed", "precise", "simulated"]);

export function element(kind, className = "", text = "") {
  const made = document.createElement(kind);
  made.className = className;
  made.textContent = text;
  return made;
}

export function put(target, text) {
  if (target.textContent !== text) target.textContent = text;
}

export class Tiles {
  constructor(list) {
    this.tiles = MOUNTS.map((mount) => {
      const tile = element("li", "tile");
      const [state, fix, age, fault] = ["tile-state", "tile-fix", "", ""].map((name) => element("p", name));
      tile.append(element("h3", "", word(mount ? capital(spaced(mount)) : "Wheel angle")), state, fix, age, fault);
      tile.dataset.state = "unknown";
      list.append(tile);
      return { mount, tile, state, fix, age, fault };
    });
  }

  // `live`: whether the status is so now; if not, `ago`: since when it is not, and a word for where it never was.
  show(status, live, ago, never) {
    for (const one of this.tiles) {
      const row = one.mount ? (status.receivers ?? []).find((r) => r.mount === one.mount) : status.wheel_angle;
      this.#showOne(one, live ? row : undefined, live ? word("not in use") : row ? word("? not heard") : never);
      if (!live && row) put(one.age, t`was ${word(spaced(row.state))} ${ago} ago`);
    }
  }

  #showOne(one, row, none) {
    const floating = row?.state === "alive" && one.mount && row.fix && !GOOD_FIXES.has(row.fix);
    one.tile.dataset.state = row ? (floating ? "warn" : STATES[row.state] ?? "warn") : "unknown";
    put(one.state, row ? word(WORDS[row.state] ?? spaced(row.state)) : none);
    put(one.fix, row && one.mount ? (row.fix ? spaced(row.fix).replace("rtk", "RTK").replace("gnss", "GNSS") : word("no fix reported")) : "");
    const parts = [];
    if (known(row?.per_s)) parts.push(`${row.per_s.toFixed(row.per_s < 9.95 ? 1 : 0)}/s`);
    if (known(row?.age_s)) parts.push(t`${time(row.age_s)} old`);
    put(one.age, parts.join(", "));
    put(one.fault, row ? fault(row) : "");
  }
}

function fault(row) {
  if (!row.fault) return word("no fault in this run");
  return row.fault_age_s > 0 ? t`was ${word(spaced(row.fault))} until ${time(row.fault_age_s)} ago` : t`${word(spaced(row.fault))} now`;
}

// What the daemon has found moved: each with buttons that accept it as it is now. The box goes when the daemon says
// that it is accepted, or back where it was.

import { t, word } from "./language.js";
import { noted } from "./marks.js";
import { element } from "./tiles.js";
import { capital } from "./words.js";

const TITLES = { pair_tractor: "the tractor's pair", pair_implement: "the implement's pair", wheel_angle: "the wheels' sensor" };

export class Moved {
  constructor(box) {
    this.box = box;
    this.shown = "[]";
  }

  show(moved) {
    const now = JSON.stringify(moved);
    this.box.hidden = !moved.length;
    if (now === this.shown) return; // a button that is being pressed stays
    this.shown = now;
    this.box.replaceChildren(...moved.map((one) => this.made(one)));
  }

  made({ names, text }) {
    const item = element("div"), told = element("p");
    told.setAttribute("role", "status");
    item.append(element("p", "", t`${capital(text)}. Put it back, or accept it as it is now:`));
    const buttons = names.map((name) => {
      const button = element("button", "", t`accept ${word(TITLES[name] ?? name.replaceAll("_", " "))}`);
      button.type = "button";
      button.dataset.accept = name;
      button.addEventListener("click", async () => {
        for (const other of buttons) other.disabled = true;
        told.textContent = word("Asking the daemon …");
        const result = await noted("/accept", name);
        for (const other of buttons) other.disabled = result.noted;
        told.textContent = result.noted ? word("✔ Accepted: it is in the log, and used.") : t`✘ Not accepted: ${result.text}`;
      });
      return button;
    });
    item.append(...buttons, told);
    return item;
  }
}

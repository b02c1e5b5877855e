// Which implement is hitched on, and what it carries: a choice where the tractor has several, buttons where the file
// says what it can carry. The page shows what the daemon says, not what was tapped.

import { t, word } from "./language.js";
import { noted } from "./marks.js";
import { element } from "./tiles.js";

const LEVELS = ["full", "half", "empty"];
const tonnes = (kg) => (kg / 1000).toFixed(1);

export class Implement {
  constructor(box) {
    this.told = box.querySelector("output");
    this.choice = box.querySelector("select");
    this.name = box.querySelector("b");
    this.load = box.querySelector("#load");
    this.box = box;
    this.shown = "";
    this.choice.addEventListener("change", () => this.ask("/implement", this.choice.value, word("A new run begins.")));
    const buttons = LEVELS.map((level) => {
      const button = element("button", "", word(level));
      button.type = "button";
      button.addEventListener("click", () => this.ask("/load", level, ""));
      return button;
    });
    this.carries = element("span");
    this.load.append(this.carries, ...buttons);
  }

  show(status) {
    const { implement: now = "", implements: all = [], load, full_load: full = 0 } = status;
    this.box.hidden = !now && !all.length && !load;
    this.load.hidden = !load;
    if (load) this.carries.textContent = load.source === "nobody"
      ? t`load not known (full: ${tonnes(full)} t)`
      : t`carries ${tonnes(load.mass ?? 0)} t ± ${tonnes(1.96 * (load.sd ?? 0))} t`;
    const shown = JSON.stringify([now, all]);
    if (shown === this.shown) return; // a list that is open stays
    this.shown = shown;
    this.now = now;
    this.choice.hidden = !all.length;
    this.name.textContent = all.length ? "" : now;
    this.choice.replaceChildren(...all.map((name) => element("option", "", name)));
    this.choice.value = now;
    this.told.textContent = "";
  }

  async ask(path, text, done) {
    this.choice.disabled = true;
    this.told.textContent = word("Asking the daemon …");
    const result = await noted(path, text);
    this.choice.disabled = false;
    this.told.textContent = result.noted ? done : t`✘ Not changed: ${result.text}`;
    if (!result.noted) this.choice.value = this.now;
  }
}

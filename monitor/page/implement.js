// Which implement is hitched on: a choice where the tractor has several. With another one a new run begins, and the
// choice shows what the daemon says, not what was tapped.

import { t, word } from "./language.js";
import { noted } from "./marks.js";
import { element } from "./tiles.js";

export class Implement {
  constructor(box) {
    this.told = box.querySelector("output");
    this.choice = box.querySelector("select");
    this.box = box;
    this.shown = "";
    this.choice.addEventListener("change", () => this.ask(this.choice.value));
  }

  show(now, all) {
    this.box.hidden = !all.length;
    const shown = JSON.stringify([now, all]);
    if (shown === this.shown) return; // a list that is open stays
    this.shown = shown;
    this.now = now;
    this.choice.replaceChildren(...all.map((name) => element("option", "", name)));
    this.choice.value = now;
    this.told.textContent = "";
  }

  async ask(name) {
    this.choice.disabled = true;
    this.told.textContent = word("Asking the daemon …");
    const result = await noted("/implement", name);
    this.choice.disabled = false;
    this.told.textContent = result.noted ? word("A new run begins.") : t`✘ Not changed: ${result.text}`;
    if (!result.noted) this.choice.value = this.now;
  }
}

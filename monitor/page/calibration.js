// A calibration while it is driven: what to do next, the stages, what is known of the numbers.
// `tilth calibrate --live` decides all of it; here it is drawn, and what the driver orders is passed on.

import { byId, list, order } from "./driver.js";
import { element, put } from "./tiles.js";

const KEPT_S = 600; // that the last word of one that has ended stays
const SURE_MS = 5000; // within which a second tap finishes
const SIGNS = { told: "✔", rough: "~", "not told": "✘" };
const whole = (text) => text.replaceAll(" ", "\u00a0"); // a unit stays with its figure
const WIDEST = 3; // times what is expected: the end of a bar
const WORDS = { told: "good", rough: "not good yet", "not told": "not known" };

export class Calibration {
  constructor() {
    this.part = byId("calibration");
    this.rows = new Map(); // of stages, by name
    this.shownNumbers = "";
    this.shownLeft = "";
    byId("calibration-compute").addEventListener("click", () => this.#order("compute", "✔ An estimate is ordered."));
    const finish = byId("calibration-finish");
    finish.addEventListener("click", () => {
      if (finish.dataset.sure) this.#order("finish", "✔ Finished.");
      finish.dataset.sure = finish.dataset.sure ? "" : "yes";
      put(finish, finish.dataset.sure ? "Finish: tap again" : "Finish");
      clearTimeout(this.sure);
      this.sure = setTimeout(() => {
        finish.dataset.sure = "";
        put(finish, "Finish");
      }, SURE_MS);
    });
  }

  async #order(kind, done) {
    const refused = await order("/calibration", kind);
    put(byId("calibration-told"), refused ? `✘ ${refused}` : done);
  }

  // state: as last heard, if it was. live: whether that is so now. age: s since it was heard.
  show(state, live, age) {
    const over = state && state.phase !== "driving";
    this.part.hidden = !state || !(live || (over && age < KEPT_S));
    if (this.part.hidden) return;
    put(byId("calibration-title"), `Calibrating ${state.machine}`);
    put(byId("calibration-text"), state.text);
    put(byId("calibration-happening"), state.happening);
    this.#say(state);
    for (const stage of state.stages) this.#stage(stage);
    list("calibration-found", state.found.map((text) => [`Found: ${text}.`]));
    put(byId("calibration-computed"), state.computed);
    list("calibration-sentences", [...state.told, ...state.notes].map((text) => [text]));
    this.#left(state.left);
    this.#numbers(state.numbers);
    for (const id of ["calibration-compute", "calibration-finish"]) byId(id).disabled = over;
  }

  // What is read out: not each metre, but each thing to do, and why nothing counts.
  #say(state) {
    const said = `${state.text} ${state.happening}`;
    const without = said.replace(/[\d.]+/g, "");
    if (without === this.said) return;
    this.said = without;
    put(byId("calibration-status"), said);
  }

  #stage(stage) {
    let row = this.rows.get(stage.name);
    if (!row) {
      const item = element("li", "calibration-stage");
      const bar = element("progress");
      bar.max = 1;
      bar.setAttribute("aria-label", stage.title);
      row = { item, title: element("h3"), bar, done: element("p", "calibration-done"), why: element("p", "quiet", `${stage.what}: ${stage.why}.`), told: element("p", "calibration-beside") };
      item.append(row.title, bar, row.done, row.why, row.told);
      byId("calibration-stages").append(item);
      this.rows.set(stage.name, row);
    }
    row.item.dataset.complete = String(stage.complete);
    put(row.title, `${stage.complete ? "✔ " : ""}${stage.title}`);
    row.bar.value = stage.share;
    put(row.done, stage.done);
    put(row.told, stage.told);
  }

  // A bar for each kind of measurement; a mark stands where what is left is just the sensors' own noise.
  #left(rows) {
    byId("calibration-left").hidden = !rows.length;
    const now = JSON.stringify(rows);
    if (now === this.shownLeft) return;
    this.shownLeft = now;
    byId("calibration-left-rows").replaceChildren(...rows.map((one) => {
      const row = element("li");
      row.dataset.more = String(one.more);
      const bar = element("span", "calibration-bar");
      bar.setAttribute("aria-hidden", "true"); // the words say it
      bar.style.setProperty("--filled", `${(Math.min(one.ratio / WIDEST, 1) * 100).toFixed(0)}%`);
      row.append(element("span", "calibration-kind", one.words), bar, element("span", "", `${one.more ? "✘" : "✔"} ${one.text}`));
      return row;
    }));
  }

  #numbers(numbers) {
    byId("calibration-numbers").hidden = !numbers.length;
    const now = JSON.stringify(numbers);
    if (now === this.shownNumbers) return;
    this.shownNumbers = now;
    byId("calibration-rows").replaceChildren(...numbers.map((one) => {
      const row = element("tr");
      row.dataset.status = one.status;
      const name = element("th");
      name.scope = "row";
      name.append(element("span", "", one.words));
      if (one.status !== "not told") name.append(element("span", "quiet", `change of the file: ${one.change}`));
      if (one.tell) name.append(element("span", "quiet", one.tell));
      row.append(name, element("td", "", `${whole(one.before)} → ${whole(one.now)}`), element("td", "", whole(one.wanted)), element("td", "calibration-word", `${SIGNS[one.status] ?? "?"} ${WORDS[one.status] ?? one.status}`));
      return row;
    }));
  }
}

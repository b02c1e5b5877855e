// The recorded runs that can be played: when, how long, where, and what was learned.

import { element, put } from "./tiles.js";
import { duration, interval, PARAMETERS } from "./words.js";
import { tell } from "./player.js";

const byId = (id) => document.getElementById(id);

export class Runs {
  show(player, machine) {
    byId("runs-part").hidden = !player;
    if (!player) return;
    byId("runs-part").classList.toggle("chosen", Boolean(player.run));
    const told = { preparing: `${player.text}: ${Math.round(100 * (player.share ?? 0))} %`, failed: `✘ ${player.text}` }[player.state] ?? "";
    put(byId("runs-told"), told || (this.refused ?? ""));
    const asked = `${player.run} ${machine}`;
    if (asked !== this.asked) {
      this.asked = asked;
      this.#ask();
    }
    if (player.run !== this.run) {
      this.run = player.run;
      if (player.run) byId("runs-part").open = false;
      this.#list();
    }
    if (!player.run && this.open === undefined) this.open = byId("runs-part").open = true;
  }

  async #ask() {
    try {
      const answer = await fetch("/player/runs");
      if (!answer.ok) throw new Error(await answer.text());
      this.runs = await answer.json();
    } catch {
      this.runs ??= [];
    }
    this.#list();
  }

  #list() {
    put(byId("runs-count"), this.runs ? `(${this.runs.length})` : "");
    byId("runs").replaceChildren(...(this.runs ?? []).map((run) => this.#row(run)));
  }

  #row(run) {
    const row = element("tr"), button = element("button", "", run.name === this.run ? "Again" : "Play"), first = element("td");
    button.type = "button";
    button.setAttribute("aria-label", `Play ${run.name}`);
    button.addEventListener("click", async () => {
      this.refused = await tell({ order: "open", run: run.name });
    });
    first.append(button);
    if (run.name === this.run) row.setAttribute("aria-current", "true");
    const name = element("th", "", run.name);
    name.scope = "row";
    const notes = [...run.notes.map((note) => `“${note}”`), run.simulated ? "simulated" : "", run.state].filter(Boolean).join("; ");
    row.append(first, name, element("td", "", run.began.replace("T", " ").replace("Z", "") || "not known"), element("td", "", run.length_s ? duration(run.length_s) : "–"), element("td", "", place(run)), element("td", "", learned(run.learned)), element("td", "", notes));
    return row;
  }
}

const place = (run) => (run.place ? `${run.place[0].toFixed(4)}°, ${run.place[1].toFixed(4)}°` : "–");

function learned(rows) {
  const told = rows.map((row) => {
    const which = PARAMETERS.find((one) => one.name === row.name), range = which && interval(row, which);
    return range ? `${row.name} ${range.value.toFixed(which.digits)} ${which.unit} (${range.low.toFixed(which.digits)} to ${range.high.toFixed(which.digits)})` : "";
  });
  return told.filter(Boolean).join(", ") || "nothing yet";
}

// The report of the run so far: a button, how it goes, and a link once it is there. The daemon makes it and says
// how it goes; the file comes through this page's server.

import { t, word } from "./language.js";
import { element } from "./tiles.js";
import { duration } from "./words.js";

const byId = (id) => document.getElementById(id);

async function ask() {
  try {
    const answer = await fetch("/report", { method: "POST", headers: { "content-type": "application/json" }, body: "{}" });
    return (await answer.json()).text;
  } catch {
    return word("the server of this page does not answer");
  }
}

export class RunReport {
  constructor() {
    this.refused = "";
    this.asking = false;
    byId("report-make").addEventListener("click", async () => {
      this.asking = true;
      this.#show(word("asking the daemon …"));
      this.refused = await ask();
      this.asking = false;
      this.show(this.report, this.alive, this.played);
    });
  }

  // report: what the daemon last said of one, if it did. played: a recorded run is shown.
  show(report, alive, played) {
    [this.report, this.alive, this.played] = [report, alive, played];
    byId("report-part").hidden = played;
    const making = report?.state === "making";
    byId("report-make").disabled = this.asking || making || !alive;
    if (this.asking) return;
    if (this.refused && !making) this.#show(t`✘ No report: ${this.refused}`, "bad");
    else if (making) this.#show(word("The report is being made; this may take some minutes. Recording has priority."), "wait");
    else if (report?.state === "failed") this.#show(t`✘ No report: ${report.text}`, "bad");
    else if (report?.state === "ready") this.#ready(report);
    else this.#show("");
    if (making) this.refused = "";
  }

  #ready(report) {
    const took = duration((report.ended_ns - report.began_ns) / 1e9);
    const link = element("a", "", word("Open the report"));
    link.href = "/report.html";
    link.target = "_blank";
    link.rel = "noopener";
    this.#put("good", `${t`✔ Made in ${took}.`} `, link, element("span", "quiet", ` ${t`${report.text}, in the folder reports of the logs`}`));
  }

  #show(words, state = "") {
    this.#put(state, words);
  }

  // Only what changed: a link that is read out or pressed stays where it is.
  #put(state, ...parts) {
    const told = byId("report-told"), said = parts.map((part) => part.textContent ?? part).join("");
    if (told.textContent === said) return;
    told.dataset.state = state;
    told.replaceChildren(...parts);
  }
}

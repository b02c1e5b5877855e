// Prompts a driver through a plan of experiments: what to do, what is still missing, a countdown, a bar to follow.
// `tilth experiment` decides all of it; here it is drawn, spoken where that is wanted, and its orders are passed on.

import { byId, list, order } from "./driver.js";
import { put } from "./tiles.js";
import { known } from "./words.js";

const APART_S = 0.1; // between the angles ahead
const LEAST = 0.035; // rad: the bar is never narrower than two degrees to either side
const SHOWN = 8; // attempts
const SIGNS = { done: "✔", aborted: "✘", disturbed: "✘", skipped: "–" };
const MAY = { arm: ["idle"], stop: ["lining_up", "countdown", "running"], skip: ["idle", "lining_up", "countdown"] };
const degrees = (angle) => `${((angle * 180) / Math.PI).toFixed(1)}°`;

export class Experiment {
  constructor() {
    this.part = byId("experiment");
    this.canvas = byId("experiment-bar");
    this.spoken = "";
    this.buttons = [...this.part.querySelectorAll("[data-order]")];
    for (const button of this.buttons) {
      button.addEventListener("click", async () => {
        const refused = await order("/experiment", button.dataset.order);
        put(byId("experiment-told"), refused ? `✘ ${refused}` : "");
      });
    }
    byId("experiment-voice").addEventListener("click", ({ target }) => {
      const on = target.getAttribute("aria-pressed") !== "true";
      target.setAttribute("aria-pressed", String(on));
      if (on) this.#say("The voice is on.");
      else window.speechSynthesis?.cancel();
    });
    byId("experiment-report").addEventListener("click", () => {
      byId("report-make").click();
      byId("report-part").scrollIntoView();
    });
  }

  // state: as last heard, if it was. live: whether that is so now.
  show(state, live) {
    this.part.hidden = !state || !live;
    if (this.part.hidden) return;
    const skipped = state.skipped ? `, ${state.skipped} of them skipped` : "";
    put(byId("experiment-title"), `Experiment ${state.plan}: ${state.done} of ${state.of} runs${skipped}`);
    const counting = known(state.count_s), running = known(state.at_s);
    put(byId("experiment-drive"), running ? `${state.drive}: ${state.at_s.toFixed(0)} of ${state.length_s.toFixed(0)} s` : state.drive);
    put(byId("experiment-text"), state.text);
    const count = byId("experiment-count");
    count.hidden = !counting;
    put(count, counting ? String(Math.ceil(state.count_s)) : "");
    this.canvas.hidden = state.phase === "finished";
    if (!this.canvas.hidden) this.#draw(state);
    put(byId("experiment-angles"), running ? `wanted ${degrees(state.wanted ?? 0)}, wheels ${known(state.measured) ? degrees(state.measured) : "not heard"}` : "");
    list("experiment-conditions", state.conditions.map((one) => [`${one.met ? "✔" : "✘"} ${one.text}`, one.met]));
    const attempts = state.attempts.slice(-SHOWN).toReversed();
    list("experiment-attempts", attempts.map((one) => [`${SIGNS[one.outcome] ?? "?"} ${this.#short(state, one.name)}: ${one.outcome}${one.reason ? `, ${one.reason}` : ""}`]));
    list("experiment-learned", [...state.learned, ...state.commands].map((line) => [line]));
    for (const button of this.buttons) button.disabled = !MAY[button.dataset.order].includes(state.phase);
    byId("experiment-report").hidden = state.phase !== "finished";
    this.#speak(counting ? String(Math.ceil(state.count_s)) : state.text);
  }

  #short = (state, name) => name.replace(`experiment ${state.plan} `, "");

  #speak(words) {
    if (words === this.spoken) return;
    this.spoken = words;
    if (byId("experiment-voice").getAttribute("aria-pressed") === "true") this.#say(words);
  }

  #say(words) {
    if (!window.speechSynthesis) return;
    window.speechSynthesis.cancel();
    window.speechSynthesis.speak(new SpeechSynthesisUtterance(words));
  }

  // Left to right as the wheels; what is wanted comes down to the line, below it are the wheels.
  #draw(state) {
    const { canvas } = this, ratio = window.devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (!width) return;
    [canvas.width, canvas.height] = [width * ratio, height * ratio];
    const pen = canvas.getContext("2d"), style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(name).trim();
    pen.scale(ratio, ratio);
    const largest = Math.max(1.3 * state.largest, LEAST), line = height - 56;
    const across = (angle) => width / 2 + (Math.min(Math.max(angle / largest, -1), 1) * (width - 32)) / 2;
    const up = (k) => line - (k / Math.max(state.ahead.length - 1, 1)) * (line - 8);
    pen.strokeStyle = colour("--line");
    pen.lineWidth = 1;
    for (const [from, to] of [[[width / 2, 0], [width / 2, height]], [[0, line], [width, line]]]) {
      pen.beginPath();
      pen.moveTo(...from);
      pen.lineTo(...to);
      pen.stroke();
    }
    pen.strokeStyle = colour("--accent");
    pen.lineWidth = 6;
    pen.beginPath();
    state.ahead.forEach((angle, k) => (k ? pen.lineTo(across(angle), up(k)) : pen.moveTo(across(angle), up(k))));
    pen.stroke();
    pen.fillStyle = colour("--accent");
    pen.fillRect(across(state.wanted ?? 0) - 22, line - 5, 44, 10);
    pen.fillStyle = colour("--ink");
    pen.font = "14px system-ui, sans-serif";
    pen.fillText(`in ${((state.ahead.length - 1) * APART_S).toFixed(0)} s`, 8, 18);
    pen.fillText("wheels", 8, height - 12);
    if (!known(state.measured)) return;
    const here = across(state.measured);
    pen.beginPath();
    pen.moveTo(here, line + 6);
    pen.lineTo(here - 16, height - 14);
    pen.lineTo(here + 16, height - 14);
    pen.fill();
  }
}

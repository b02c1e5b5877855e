// Plays a recorded run: a bar under the map, and what one may want to jump to. The player is told what to do;
// what is shown is what it says of itself.

import { element, put } from "./tiles.js";
import { clock, duration, spaced } from "./words.js";

const EVERY_MS = 150; // between two orders while the slider is drawn
const HELD_MS = 600; // the slider stays where it was put until the player has gone there
const STRONG = new Set(["mark", "turn"]);
const WORDS = { idle: "no run is open", preparing: "getting ready", paused: "paused", playing: "playing", ended: "at its end", failed: "cannot be played" };
const byId = (id) => document.getElementById(id);

export async function tell(order) {
  try {
    const answer = await fetch("/player", { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(order) });
    return (await answer.json()).text;
  } catch {
    return "the page's own server does not answer";
  }
}

export class PlayerBar {
  constructor() {
    this.heldAt = -Infinity;
    this.sentAt = -Infinity;
    const slider = byId("play-slider");
    byId("play").addEventListener("click", () => this.#order({ order: this.player?.state === "playing" ? "pause" : "play" }));
    byId("play-rate").addEventListener("change", (event) => this.#order({ order: "rate", rate: Number(event.target.value) }));
    slider.addEventListener("input", () => {
      this.#hold();
      if (performance.now() - this.sentAt > EVERY_MS) this.#seek(Number(slider.value));
    });
    slider.addEventListener("change", () => this.#seek(Number(slider.value)));
    document.addEventListener("keydown", (event) => {
      if (event.key !== " " || byId("player").hidden || event.target !== document.body) return;
      event.preventDefault();
      byId("play").click();
    });
  }

  show(player) {
    const is = Boolean(player);
    for (const id of ["player", "places-part"]) byId(id).hidden = !is || !player.run;
    if (!is) return;
    this.player = player;
    const { state, at_s, length_s, rate, run } = player, playing = state === "playing", slider = byId("play-slider");
    put(byId("play-sign"), playing ? "❚❚" : "▶");
    byId("play").setAttribute("aria-label", playing ? "Pause" : "Play");
    if (document.activeElement !== byId("play-rate")) byId("play-rate").value = String(rate);
    slider.max = String(Math.max(1, length_s));
    const held = performance.now() - this.heldAt < HELD_MS;
    if (!held) slider.value = String(at_s);
    const words = `${duration(at_s)} of ${duration(length_s)}`;
    slider.setAttribute("aria-valuetext", words);
    put(byId("play-time"), words);
    put(byId("play-state"), `${WORDS[state] ?? state}${player.text ? `: ${player.text}` : ""}`);
    if (run !== this.run) {
      this.run = run;
      this.#ask();
    }
    this.#here(at_s);
  }

  async #ask() {
    this.places = [];
    this.#list();
    if (!this.run) return;
    try {
      const { run, places } = await (await fetch("/player/places")).json();
      if (run === this.run) this.places = places;
    } catch {
      put(byId("play-told"), "What one could jump to cannot be asked for.");
    }
    this.#list();
  }

  #list() {
    const length = Math.max(1, this.player?.length_s ?? 1);
    byId("play-ticks").replaceChildren(...this.places.map(({ at_s, kind }) => {
      const tick = element("i", STRONG.has(kind) ? `tick tick-${kind}` : "tick");
      tick.style.left = `${(100 * at_s) / length}%`;
      return tick;
    }));
    this.items = this.places.map((place) => {
      const item = element("li"), button = element("button", "place");
      button.type = "button";
      button.append(element("span", "place-at", duration(place.at_s)), element("b", "", ` ${spaced(place.kind)} `), place.text, element("span", "quiet", ` ${clock(place.t_ns)}`));
      button.addEventListener("click", () => {
        this.#hold();
        byId("play-slider").value = String(place.at_s);
        this.#seek(place.at_s);
      });
      item.append(button);
      return item;
    });
    byId("places").replaceChildren(...(this.items.length ? this.items : [element("li", "quiet", "No mark, event or turn.")]));
  }

  // The last one before here is said to be the current one.
  #here(at_s) {
    const last = this.places?.findLastIndex((place) => place.at_s <= at_s + 0.001) ?? -1;
    this.items?.forEach((item, i) => {
      const button = item.firstChild;
      if (i === last) button.setAttribute("aria-current", "true");
      else button.removeAttribute("aria-current");
    });
  }

  #hold() {
    this.heldAt = performance.now();
  }

  #seek(at_s) {
    this.sentAt = performance.now();
    this.#order({ order: "seek", at_s });
  }

  async #order(order) {
    put(byId("play-told"), await tell(order));
  }
}

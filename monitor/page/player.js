// Plays a recorded run: a bar under the map, and what one may want to jump to. The player is told what to do;
// what is shown is what it says of itself.

import { t, word } from "./language.js";
import { element, put } from "./tiles.js";
import { clock, duration, spaced } from "./words.js";

const EVERY_MS = 150; // between two orders while the slider is drawn
const LOST_MS = 5000; // the slider stays where it was put until the player has gone there, but no longer
const STRONG = new Set(["mark", "turn"]);
const WORDS = { idle: "no run is open", preparing: "getting ready", paused: "paused", playing: "playing", ended: "at its end", failed: "cannot be played" };
const byId = (id) => document.getElementById(id);

export async function tell(order) {
  try {
    const answer = await fetch("/player", { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(order) });
    return (await answer.json()).text;
  } catch {
    return word("the server of this page does not answer");
  }
}

export class PlayerBar {
  constructor() {
    this.wanted = null; // s, where the player was told to go and has not been seen yet
    this.sentAt = -Infinity;
    this.waiting = []; // orders
    this.sending = false;
    const slider = byId("play-slider");
    byId("play").addEventListener("click", () => this.#order({ order: this.player?.state === "playing" ? "pause" : "play" }));
    byId("play-rate").addEventListener("change", (event) => this.#order({ order: "rate", rate: Number(event.target.value) }));
    slider.addEventListener("input", () => {
      this.#hold(Number(slider.value));
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
    byId("play").setAttribute("aria-label", word(playing ? "Pause" : "Play"));
    if (document.activeElement !== byId("play-rate")) byId("play-rate").value = String(rate);
    slider.max = String(Math.max(1, length_s));
    if (this.#isThere(at_s, rate)) slider.value = String(at_s);
    const words = t`${duration(at_s)} of ${duration(length_s)}`;
    slider.setAttribute("aria-valuetext", words);
    put(byId("play-time"), words);
    put(byId("play-state"), `${word(WORDS[state] ?? state)}${player.text ? `: ${player.text}` : ""}`);
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
      put(byId("play-told"), word("The list of places to jump to could not be loaded."));
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
      button.append(element("span", "place-at", duration(place.at_s)), element("b", "", ` ${word(spaced(place.kind))} `), place.text, element("span", "quiet", ` ${clock(place.t_ns)}`));
      button.addEventListener("click", () => {
        byId("play-slider").value = String(place.at_s);
        this.#seek(place.at_s);
      });
      item.append(button);
      return item;
    });
    byId("places").replaceChildren(...(this.items.length ? this.items : [element("li", "quiet", word("No mark, event or turn."))]));
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

  #hold(at_s) {
    this.wanted = at_s;
    this.heldAt = performance.now();
  }

  // A player that plays is seen up to two seconds later than where it was told to go.
  #isThere(at_s, rate) {
    if (this.wanted === null) return true;
    const past = Math.round(at_s) - Math.round(this.wanted), most = this.player.state === "playing" ? 2 * rate : 0;
    if ((past >= 0 && past <= most) || performance.now() - this.heldAt > LOST_MS) this.wanted = null;
    return this.wanted === null;
  }

  #seek(at_s) {
    this.#hold(at_s);
    this.sentAt = performance.now();
    this.#order({ order: "seek", at_s });
  }

  // One at a time, since requests may overtake each other; the newest of a kind replaces those that wait.
  async #order(order) {
    this.waiting = [...this.waiting.filter((one) => one.order !== order.order), order];
    if (this.sending) return;
    this.sending = true;
    while (this.waiting.length) put(byId("play-told"), await tell(this.waiting.shift()));
    this.sending = false;
  }
}

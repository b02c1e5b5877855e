// Hears this computer's page server and shows what it says. Whatever comes is text, never markup.

import { Calibration } from "./calibration.js";
import { Experiment } from "./experiment.js";
import { prepareSwitch, said as inLanguage, t, translatePage, word } from "./language.js";
import { showLengths } from "./lengths.js";
import { FieldMap } from "./map.js";
import { prepareMarks } from "./marks.js";
import { Implement } from "./implement.js";
import { Moved } from "./moved.js";
import { Over } from "./over.js";
import { PlayerBar } from "./player.js";
import { RunReport } from "./report.js";
import { Runs } from "./runs.js";
import { Steering } from "./steering.js";
import { element, put, Tiles } from "./tiles.js";
import { Traces } from "./traces.js";
import { capital, clock, duration, firstDrive, flagged, hours, known, OLD_S, PARAMETERS, preparing, spaced, time } from "./words.js";

const LOST_MS = 3000; // the page's server says something each second
const ANEW_MS = 5000; // then another connection is tried: this one may be dead without a word
const EVENTS = 100;
const KEPT = "tilth-last"; // in this browser: what the page showed last, and when
const KEEP_MS = 5000;
const LONGEST_KEPT_MS = 24 * 3600 * 1000;
const QUIET_EVENTS = new Set(["heartbeat"]);
const SIGNS = { soft: "▽", firm: "▲", "as usual": "●", "between soft and usual": "◒", "between usual and firm": "◓", "known roughly": "○", withdrawn: "✘" };
const TECHNICAL = new Set(["addresses", "bus", "clock", "coarse_stamps", "compiled", "disagreement", "fit", "other_clock", "other_time", "positions_repeated", "positions_slow", "stored_state", "warm_start", "zenoh"]);
const byId = (id) => document.getElementById(id);
translatePage();
prepareSwitch(byId("language"));

const tiles = new Tiles(byId("tiles"));
const traces = new Traces(byId("traces"));
const steering = new Steering(byId("steering"), () => traces.times);
const bar = new PlayerBar(), runs = new Runs(), report = new RunReport(), experiment = new Experiment();
const calibration = new Calibration(), over = new Over();
const moved = new Moved(byId("moved"));
const implement = new Implement(byId("implement"));
const map = new FieldMap(byId("map"), (on) => byId("follow").setAttribute("aria-pressed", String(on)));
let heard = { notes: [], age_s: {}, events: [] };
let heardAt = 0; // performance.now, ms
let connected; // not known until it is or was refused

function age(kind) {
  const then = heard.age_s[kind];
  return known(then) ? then + (performance.now() - heardAt) / 1000 : undefined;
}

const reached = () => connected && performance.now() - heardAt < LOST_MS;
// Whether the last message of a kind is so now: whoever is between its sender and here may have gone.
const live = (kind) => Boolean(reached() && heard.alive && age(kind) <= OLD_S[kind]);

function take(message) {
  const whole = "whole" in message;
  const said = whole ? message.whole : message.new;
  if (!said) return;
  const events = whole ? said.events : heard.events.concat(said.events).slice(-EVENTS);
  heard = whole ? said : { ...heard, ...said };
  heard.events = events;
  heardAt = performance.now();
  if (said.rig) {
    map.rig = said.rig;
    showLengths(said.rig);
    traces.setPriors(said.rig);
  }
  if (said.status || whole) map.receivers = said.status?.receivers;
  if (whole) map.setTrack(said.track);
  else if (said.track) map.addTrack(said.track);
  for (const [rows, place] of [[said.estimates, traces], [said.steering, steering]]) {
    if (rows) place[whole ? "setAll" : "add"](rows);
  }
  if (said.steering) traces.draw(); // they share their times
  heard.estimates = heard.track = heard.steering = undefined; // they live where they are drawn
  if (said.pose || whole) map.setPose(said.pose);
  if (whole || said.events.length) showEvents(events);
  if (said.shown) showKnown();
  else if (whole) forgetKnown();
  if (said.pose) showPose(said.pose);
  if (said.experiment) experiment.show(heard.experiment, live("experiment"));
  if (said.calibration) showCalibration();
  byId("setup").hidden = !heard.setup;
  if (whole || said.status || said.player || said.report || said.over || said.first_drive) show(); // else soon enough by the clock
}

const showCalibration = () => calibration.show(heard.calibration, live("calibration"), age("calibration"));

function show() {
  const status = heard.status ?? {};
  showRun(status);
  showProblems(status);
  implement.show(live("status") && !heard.player ? status : {});
  moved.show(live("status") && !heard.player ? (status.moved ?? []) : []);
  showPreparing(status);
  showFacts(status);
  showAges();
  const chosen = heard.first_drive ? undefined : heard.player; // that one plays by itself
  bar.show(chosen);
  runs.show(chosen, heard.machine);
  over.show(heard.over);
  report.show(heard.report, Boolean(reached() && heard.alive), Boolean(heard.player));
  tiles.show(status, live("status"), time(age("status")), word(heard.player?.run ? "? not in the log" : "? not heard"));
  map.setOld(!live("pose"));
  experiment.show(heard.experiment, live("experiment"));
  showCalibration();
  if (heard.shown) traces.tell(heard.soil_tire, heard.shown, !live("soil_tire"), age("soil_tire"));
  put(byId("machine"), heard.machine || "Tilth");
  byId("simulated").hidden = !heard.simulated;
  put(byId("simulated"), heard.first_drive ? word("recorded simulated drive") : heard.player?.run ? t`replay of ${heard.player.run}` : heard.player ? word("replay") : word("simulation"));
  const marks = document.querySelector(".marks");
  marks.hidden = Boolean(heard.player || heard.over);
  marks.disabled = Boolean(reached() && !heard.alive);
}

// Each part of the page names the message that it shows; where that is no longer so, it says how old it is.
function showAges() {
  for (const part of document.querySelectorAll("[data-live]")) {
    const kind = part.dataset.live, then = age(kind), old = known(then) && !live(kind) && !heard.over;
    part.toggleAttribute("data-old", old);
    for (const place of part.querySelectorAll(".age")) put(place, old ? t`${time(then)} old` : "");
  }
}

function showRun(status) {
  const ago = known(age("status")) ? t`for ${time(age("status"))}` : "";
  let [told, state, beside] = ["NOT RECORDING", "bad", known(status.uptime_s) ? duration(status.uptime_s) : ""];
  if (connected === undefined) [told, state, beside] = ["WAITING", "wait", ""];
  else if (!reached()) [told, beside] = ["NO CONNECTION", ago];
  else if (heard.over) [told, state, beside] = ["DEMO OVER", "wait", ""];
  else if (heard.first_drive) [told, state, beside] = ["RECORDED DRIVE", "wait", ""];
  else if (heard.player && heard.alive) [told, state, beside] = ["REPLAY", "wait", playing(heard.player)];
  else if (heard.waiting) [told, state, beside] = ["WAITING", "wait", word("for the daemon")];
  else if (!ago && !heard.alive) [told, beside] = ["NO DAEMON", ""];
  else if (!live("status")) [told, beside] = [heard.alive ? "SILENT" : "DAEMON GONE", ago];
  else if (status.resting) [told, state] = ["RESTING", "warn"];
  else if (status.recording) [told, state] = ["● RECORDING", "good"];
  const inWords = word(told);
  put(byId("run-word"), inWords);
  put(byId("run-time"), beside);
  byId("run").dataset.state = state;
  document.title = `${heard.machine || "Tilth"}${state === "bad" ? ` – ${inWords}` : ""}`;
}

const playing = ({ state, rate }) => (state === "playing" ? `${rate} ×` : word(state === "idle" ? "choose a run" : state));

function showProblems(status) {
  const lost = connected !== undefined && !reached();
  const gone = gaveWay
    ? word("Too many pages are open, so this one was paused. Touch it to continue here.")
    : word("The server of this page does not answer: is `tilth monitor` running? Trying again.");
  const lines = lost ? [gone] : [...(inLanguage(heard, "notes") ?? [])];
  if (live("status")) lines.push(...(status.problems ?? []).map(capital));
  const box = byId("problems");
  box.dataset.state = live("status") && status.recording ? "warn" : "bad";
  putLines(box, lines);
  box.hidden = !lines.length;
}

// Only what is new: whoever has the page read aloud hears each line once.
function putLines(box, lines) {
  const shown = [...box.children].map((line) => line.textContent);
  if (lines.join("\n") !== shown.join("\n")) box.replaceChildren(...lines.map((line) => element("p", "", line)));
}

function showPreparing(status) {
  const busy = live("status") && status.preparing;
  const first = heard.first_drive && reached();
  const text = first ? firstDrive(heard.first_drive) : busy ? preparing(status, age("status")) : reached() && heard.waiting ? word("Waiting for the daemon: it may have just been started.") : "";
  put(byId("preparing"), text);
  byId("preparing").hidden = !text;
}

function fact(id, text, state = "") {
  put(byId(id), text);
  byId(id).dataset.state = state;
}

function showFacts(status) {
  const left = status.hours_left, now = live("status");
  fact("disk", hours(left), !now || !known(left) ? "" : left < 1 ? "bad" : left < 4 ? "warn" : "");
  const buses = status.buses ?? [];
  const ill = buses.find((bus) => bus.state !== "open");
  const loads = buses.map((bus) => (known(bus.load) ? `${Math.round(100 * bus.load)} %` : `${Math.round(bus.frames_per_s)}/s`));
  const busy = buses.some((bus) => bus.load > 0.8);
  fact("bus", ill ? `${ill.name} ${word(ill.state)}` : loads.join(", ") || "–", !now ? "" : ill ? "bad" : busy ? "warn" : "");
  const lost = buses.reduce((sum, bus) => sum + bus.lost_frames, 0);
  fact("lost", buses.length ? String(lost) : "–", now && lost ? "bad" : "");
}

function showPose(pose) {
  const speed = pose.tractor?.forward_velocity;
  fact("speed", known(speed) ? `${(3.6 * speed).toFixed(1)} km/h` : "–");
  const degrees = (angle) => `${((angle * 180) / Math.PI).toFixed(1)}°`;
  const words = [t`${pose.receivers} of 4 receivers`];
  if (known(pose.articulation)) words.push(t`hitch ${degrees(pose.articulation)}`);
  if (known(pose.wheel_angle)) words.push(t`wheels ${degrees(pose.wheel_angle)}`);
  words.push(...leans());
  if (pose.flags.length) words.push(pose.flags.map(flagged).join(", "));
  put(byId("map-words"), words.join(" · "));
}

// How the bodies lean on their tyres, and the slope under the tractor, as far as the estimator knows.
function leans() {
  if (!live("soil_tire")) return [];
  const told = Object.fromEntries((heard.soil_tire.excitation ?? []).map(({ name, value }) => [name, value]));
  const side = (angle) => `${Math.abs(angle).toFixed(1)}°${Math.abs(angle) < 0.05 ? "" : ` ${word(angle > 0 ? "right" : "left")}`}`;
  const named = { lean_tractor_deg: "tractor leans", lean_implement_deg: "implement leans", cross_slope_deg: "slope down" };
  return Object.entries(named).filter(([name]) => known(told[name])).map(([name, what]) => `${word(what)} ${side(told[name])}`);
}

function showKnown() {
  const { soil_tire: estimate, shown } = heard;
  const open = PARAMETERS.filter((_, i) => shown.status[i] !== 1);
  const why = inLanguage(shown, "why")[PARAMETERS.indexOf(open[0])] || word("no estimate yet");
  const plain = !open.length ? word("All six are estimated.") : `${open.length < 6 ? `${open.map((one) => one.name).join(", ")}: ` : ""}${capital(why)}.`;
  put(byId("advice"), shown.withdrawn.length ? word("The numbers are withdrawn; the reason is above.") : inLanguage(shown, "advised") || plain);
  byId("known").replaceChildren(...PARAMETERS.map((one, i) => {
    const item = element("li");
    item.append(element("b", "", word(one.title)), ` ${one.name}: ${knowledge(shown.known[i])}`);
    return item;
  }));
  const names = shown.determined.length ? t`The data alone determine ${shown.determined.join(", ")}. Each ± is 95 %.` : "";
  put(byId("method"), [names, estimate.rule ? t`Method: ${inLanguage(estimate, "rule")}.` : ""].filter(Boolean).join(" "));
  byId("place").hidden = !shown.place;
  if (shown.place) {
    put(byId("place-words"), inLanguage(shown.place, "words"));
    byId("place").querySelectorAll("i").forEach((part, i) => { part.style.flexGrow = shown.place.shares[i]; });
  }
  showGround(shown.ground);
  putLines(byId("withdrawn-why"), inLanguage(shown, "withdrawn"));
  byId("withdrawn").hidden = !shown.withdrawn.length;
}

// Another run, or a place in it at which nothing was estimated yet.
function forgetKnown() {
  put(byId("advice"), word("Nothing has been heard yet."));
  put(byId("method"), "");
  byId("known").replaceChildren();
  byId("ground").replaceChildren(element("li", "", word("Nothing has been heard yet.")));
  byId("withdrawn").hidden = byId("place").hidden = true;
  traces.forget();
}

function knowledge(share) {
  if (share === undefined) return word("not judged yet");
  return share === null ? word("not determined") : t`known to ${share}`;
}

function showGround(ground) {
  const list = byId("ground");
  if (!list.querySelector("strong")) list.replaceChildren(...ground.map((_, i) => madeGround(PARAMETERS[i])));
  ground.forEach((one, i) => {
    const soil = one.word;
    const item = list.children[i];
    item.dataset.word = soil;
    put(item.querySelector(".sign"), `${SIGNS[soil] ?? "?"} `);
    put(item.querySelector(".word"), word(soil));
    put(item.querySelector(".ground-text"), inLanguage(one, "text"));
  });
}

function madeGround({ title, name }) {
  const item = element("li", "now"), sign = element("span", "sign"), said = element("strong");
  sign.setAttribute("aria-hidden", "true");
  said.append(sign, element("span", "word"));
  item.append(element("b", "", word(title)), element("span", "quiet", ` ${name}`), said, element("span", "ground-text"));
  return item;
}

function showEvents(events) {
  const all = byId("technical").getAttribute("aria-pressed") === "true";
  const shown = events.filter(({ kind }) => !QUIET_EVENTS.has(kind) && (all || !TECHNICAL.has(kind)));
  const items = shown.toReversed().map((event) => {
    const item = element("li"), at = element("time", "", clock(event.t_ns));
    item.append(at, element("b", "", `${word(spaced(event.kind))} `), inLanguage(event, "text"));
    return item;
  });
  byId("events").replaceChildren(...(items.length ? items : [element("li", "quiet", word("None yet."))]));
  traces.setEvents(events);
}

// The stream: again and again, for as long as the page is open.
let wait_ms = 250, stream, triedAt = 0, gaveWay = false;
const GIVEN_WAY = 4001; // the server's code where a page makes room for another one

function connect() {
  triedAt = performance.now();
  stream = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  stream.onmessage = (event) => {
    wait_ms = 250;
    connected = true;
    take(JSON.parse(event.data));
  };
  stream.onclose = again;
}

function again(event) {
  stream = undefined;
  connected = false;
  gaveWay = event?.code === GIVEN_WAY;
  show();
  // A server that was started anew may want the code again, and says so to whoever opens the page.
  if (event) fetch("/page.webmanifest", { cache: "no-store" }).then(({ status }) => status === 403 && location.reload(), () => {});
  if (gaveWay) { // it does not push out another one before somebody looks at it
    addEventListener("pointerdown", connect, { once: true });
    return;
  }
  setTimeout(connect, wait_ms);
  wait_ms = Math.min(2 * wait_ms, 2000);
}

// A way that broke without a word, as a phone's does out of reach, is never closed by its other end.
function watch() {
  if (stream && performance.now() - Math.max(heardAt, triedAt) > ANEW_MS) {
    stream.onclose = stream.onmessage = null;
    stream.close();
    again();
  } else show();
}

// A page that is opened while the network is away shows what it showed last, as old as that is.
function keepLast() {
  if (!reached()) return;
  try {
    localStorage.setItem(KEPT, JSON.stringify({ at: Date.now() - (performance.now() - heardAt), state: heard }));
  } catch { /* a browser that keeps nothing, or has no room */ }
}

function showLast() {
  try {
    const { at, state } = JSON.parse(localStorage.getItem(KEPT)), ago = Date.now() - at;
    if (!(ago >= 0 && ago < LONGEST_KEPT_MS)) return;
    take({ whole: { ...state, waiting: false } });
    heardAt = performance.now() - ago;
  } catch { /* nothing was kept, or by another release */ }
}

function prepareTheme() {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  let chosen = "";
  const apply = () => {
    document.documentElement.dataset.theme = chosen || (dark.matches ? "dark" : "light");
    traces.recolour();
    steering.recolour();
    map.recolour();
  };
  byId("theme").addEventListener("click", () => {
    chosen = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
    apply();
  });
  dark.addEventListener("change", apply);
  apply();
}

byId("technical").addEventListener("click", ({ currentTarget: button }) => {
  button.setAttribute("aria-pressed", String(button.getAttribute("aria-pressed") !== "true"));
  showEvents(heard.events);
});
byId("zoom-in").addEventListener("click", () => map.zoom(1.5));
byId("zoom-out").addEventListener("click", () => map.zoom(1 / 1.5));
byId("fit").addEventListener("click", () => map.fit());
byId("follow").addEventListener("click", () => map.follow(!map.following));
for (const button of document.querySelectorAll("[data-seconds]")) {
  button.addEventListener("click", () => {
    for (const other of document.querySelectorAll("[data-seconds]")) other.setAttribute("aria-pressed", String(other === button));
    traces.range(Number(button.dataset.seconds));
    steering.draw();
  });
}
// What stays in sight stays above the bar.
new ResizeObserver(([{ target }]) => {
  const below = getComputedStyle(target).position === "fixed" ? target.offsetHeight : 0;
  document.documentElement.style.setProperty("--bar", `${below}px`);
}).observe(document.querySelector(".bar"));
prepareMarks();
prepareTheme();
setInterval(watch, 500);
setInterval(keepLast, KEEP_MS);
addEventListener("pagehide", keepLast);
navigator.serviceWorker?.register("/worker.js").catch(() => {}); // only over https, and on the computer itself
showLast();
connect();
show();

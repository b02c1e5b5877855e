// Hears this computer's page server and shows what it says. Whatever comes is text, never markup.

import { FieldMap } from "./map.js";
import { element, put, Tiles } from "./tiles.js";
import { Traces } from "./traces.js";
import { capital, clock, duration, hours, known, PARAMETERS, share, spaced, time } from "./words.js";

const SILENT_S = 3; // status comes each second
const EVENTS = 100;
const MARK_BYTES = 1024;
const QUIET_EVENTS = new Set(["heartbeat"]);
const byId = (id) => document.getElementById(id);

const tiles = new Tiles(byId("tiles"));
const traces = new Traces(byId("traces"));
const map = new FieldMap(byId("map"), (on) => byId("follow").setAttribute("aria-pressed", String(on)));
let heard = { notes: [], age_s: {}, events: [] };
let heardAt = 0; // performance.now, ms
let connected = false;
let lastText = "";

function age(kind) {
  const then = heard.age_s[kind];
  return known(then) ? then + (performance.now() - heardAt) / 1000 : undefined;
}

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
    traces.setPriors(said.rig);
  }
  if (said.status) map.receivers = said.status.receivers;
  if (whole) {
    map.setTrack(said.track);
    traces.setAll(said.estimates);
    heard.estimates = heard.track = undefined; // they live where they are drawn
  } else if (said.soil_tire) traces.add(said.soil_tire);
  if (said.pose) map.setPose(said.pose, !whole);
  if (whole || said.events.length) showEvents(events);
  if (whole || said.soil_tire) showKnown();
  if (said.pose) showPose(said.pose);
  if (whole || said.status) show(); // else soon enough by the clock
}

function show() {
  const statusAge = age("status");
  const silent = !connected || !heard.alive || !known(statusAge) || statusAge > SILENT_S;
  const status = heard.status ?? {};
  showRun(status, silent, statusAge);
  showProblems(status, silent);
  showFacts(status, silent);
  tiles.show(status, silent);
  if (heard.soil_tire) traces.tell(heard.soil_tire, connected ? age("soil_tire") : undefined);
  put(byId("machine"), heard.machine || "Tilth");
  byId("simulated").hidden = !heard.simulated;
  document.title = `${heard.machine || "Tilth"}${silent || status.recording ? "" : " – NOT RECORDING"}`;
}

function showRun(status, silent, statusAge) {
  let [word, state, beside] = ["NOT RECORDING", "bad", known(status.uptime_s) ? duration(status.uptime_s) : ""];
  const ago = known(statusAge) ? `for ${time(statusAge)}` : "";
  if (!connected) [word, beside] = ["NO CONNECTION", ""];
  else if (!heard.machine) [word, state, beside] = ["NO DAEMON", "bad", ""];
  else if (silent) [word, beside] = [heard.alive ? "SILENT" : "DAEMON GONE", ago];
  else if (status.resting) [word, state] = ["RESTING", "warn"];
  else if (status.recording) [word, state] = ["● RECORDING", "good"];
  put(byId("run-word"), word);
  put(byId("run-time"), beside);
  byId("run").dataset.state = state;
}

function showProblems(status, silent) {
  const lines = connected ? [...heard.notes] : ["The page's own server does not answer: is `tilth monitor` running? Trying again."];
  if (connected && !silent) lines.push(...(status.problems ?? []).map(capital));
  const box = byId("problems");
  const text = lines.join("\n");
  box.dataset.state = !connected || silent || !status.recording ? "bad" : "warn";
  if (text !== lastText) {
    lastText = text;
    box.replaceChildren(...lines.map((line) => element("p", "", line)));
  }
  box.hidden = !lines.length;
}

function fact(id, text, state = "") {
  put(byId(id), text);
  byId(id).dataset.state = state;
}

function showFacts(status, silent) {
  const left = status.hours_left;
  fact("disk", silent ? "–" : hours(left), silent || !known(left) ? "" : left < 1 ? "bad" : left < 4 ? "warn" : "");
  const buses = silent ? [] : status.buses ?? [];
  const ill = buses.find((bus) => bus.state !== "open");
  const loads = buses.map((bus) => (known(bus.load) ? `${Math.round(100 * bus.load)} %` : `${Math.round(bus.frames_per_s)}/s`));
  fact("bus", ill ? `${ill.name} ${ill.state}` : loads.join(", ") || "–", ill ? "bad" : buses.some((bus) => bus.load > 0.8) ? "warn" : "");
  const lost = buses.reduce((sum, bus) => sum + bus.lost_frames, 0);
  fact("lost", buses.length ? String(lost) : "–", lost ? "bad" : "");
}

function showPose(pose) {
  const speed = pose.tractor?.forward_velocity;
  fact("speed", known(speed) ? `${(3.6 * speed).toFixed(1)} km/h` : "–");
  const degrees = (angle) => `${((angle * 180) / Math.PI).toFixed(1)}°`;
  const words = [`${pose.receivers} of 4 receivers`];
  if (known(pose.articulation)) words.push(`hitch ${degrees(pose.articulation)}`);
  if (known(pose.wheel_angle)) words.push(`wheels ${degrees(pose.wheel_angle)}`);
  if (pose.flags.length) words.push(pose.flags.map((flag) => spaced(flag.replace(":", " "))).join(", "));
  put(byId("map-words"), words.join(" · "));
}

function showKnown() {
  const estimate = heard.soil_tire;
  if (!estimate) return;
  const open = estimate.parameters.filter((row) => row.status !== 1);
  const plain = !open.length ? "All six are estimated." : `${open.length < 6 ? `${open.map((row) => row.name).join(", ")}: ` : ""}${capital(open[0].reason || "no estimate yet")}.`;
  put(byId("advice"), estimate.advice ? `${estimate.advice}.` : plain);
  byId("known").replaceChildren(...estimate.parameters.map((row, i) => {
    const item = element("li"), bound = estimate.bound[i];
    item.append(element("b", "", PARAMETERS[i].title), ` ${row.name}: ${knowledge(bound)}`);
    return item;
  }));
  const names = estimate.determined.length ? `The data alone determine ${estimate.determined.join(", ")}.` : "";
  put(byId("method"), [names, estimate.rule ? `Method: ${estimate.rule}.` : ""].filter(Boolean).join(" "));
}

function knowledge(bound) {
  if (bound === undefined) return "not judged yet";
  return known(bound) && share(bound) ? `known to ${share(bound)}` : "not determined";
}

function showEvents(events) {
  const shown = events.filter((event) => !QUIET_EVENTS.has(event.kind));
  const items = shown.toReversed().map((event) => {
    const item = element("li"), at = element("time", "", clock(event.t_ns));
    item.append(at, element("b", "", `${spaced(event.kind)} `), event.text);
    return item;
  });
  byId("events").replaceChildren(...(items.length ? items : [element("li", "quiet", "None yet.")]));
  traces.setEvents(shown);
}

// The stream: again and again, for as long as the page is open.
let wait_ms = 250;

function connect() {
  const stream = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  stream.onmessage = (event) => {
    wait_ms = 250;
    connected = true;
    take(JSON.parse(event.data));
  };
  stream.onclose = () => {
    connected = false;
    show();
    setTimeout(connect, wait_ms);
    wait_ms = Math.min(2 * wait_ms, 2000);
  };
}

function prepareMark() {
  const [dialog, input, answer, send, cancel] = ["mark-dialog", "mark-text", "mark-told", "mark-send", "mark-cancel"].map(byId);
  const open = () => {
    put(answer, "");
    put(cancel, "Cancel");
    dialog.showModal();
    input.focus();
  };
  byId("mark").addEventListener("click", open);
  cancel.addEventListener("click", () => dialog.close());
  document.addEventListener("keydown", (event) => {
    const typing = dialog.open || event.target.closest?.("input, textarea");
    if (event.key.toLowerCase() === "m" && !typing && !event.ctrlKey && !event.metaKey && !event.altKey) {
      event.preventDefault();
      open();
    }
  });
  byId("mark-form").addEventListener("submit", async (event) => {
    event.preventDefault();
    const size = new TextEncoder().encode(input.value).length;
    if (size > MARK_BYTES) {
      put(answer, `✘ This note has ${size} bytes; ${MARK_BYTES} are the most.`);
      return;
    }
    send.disabled = true;
    put(answer, "Asking the daemon …");
    const result = await sendMark(input.value);
    send.disabled = false;
    put(answer, result.noted ? "✔ It is in the log." : `✘ Not in the log: ${result.text}`);
    if (result.noted) {
      input.value = "";
      put(cancel, "Close");
      cancel.focus();
    }
  });
}

async function sendMark(text) {
  try {
    const answer = await fetch("/mark", { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ text }) });
    return await answer.json();
  } catch {
    return { noted: false, text: "the page's own server does not answer" };
  }
}

function prepareTheme() {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  let chosen = "";
  const apply = () => {
    document.documentElement.dataset.theme = chosen || (dark.matches ? "dark" : "light");
    traces.recolour();
    map.recolour();
  };
  byId("theme").addEventListener("click", () => {
    chosen = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
    apply();
  });
  dark.addEventListener("change", apply);
  apply();
}

byId("zoom-in").addEventListener("click", () => map.zoom(1.5));
byId("zoom-out").addEventListener("click", () => map.zoom(1 / 1.5));
byId("fit").addEventListener("click", () => map.fit());
byId("follow").addEventListener("click", () => map.follow(!map.following));
for (const button of document.querySelectorAll("[data-seconds]")) {
  button.addEventListener("click", () => {
    for (const other of document.querySelectorAll("[data-seconds]")) other.setAttribute("aria-pressed", String(other === button));
    traces.range(Number(button.dataset.seconds));
  });
}
prepareMark();
prepareTheme();
setInterval(show, 500);
connect();
show();

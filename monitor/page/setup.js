// Makes a machine file step by step. What is written stays in this browser until it is saved; the server drafts and
// checks. Whatever comes is text, never markup.

import { prepareSwitch, t, translatePage, word } from "./language.js";
import { element, put } from "./tiles.js";
import { capital, spaced } from "./words.js";

const ASK_MS = 2000;
const KEPT = "tilth-setup";
const SVG = "http://www.w3.org/2000/svg";
const MOUNTS = ["tractor_front", "tractor_rear", "implement_front", "implement_rear"];
const PARTS = [["ahead", "ahead of the rear axle"], ["right", "right of the middle"], ["height", "above the ground"]];
const HOW = {
  length: [["tape", "by tape: 2 cm"], ["sheet", "data sheet: 5 cm"], ["paced", "roughly: 15 cm"]],
  mass: [["scale", "on a scale: 1 %"], ["sheet", "papers: 5 %"], ["guess", "estimated: 15 %"]],
};
const MAKERS = [["", "maker not known"], ["33", "John Deere"], ["98", "Trimble"], ["231", "Topcon"], ["88", "Hemisphere"]];
const SIGNS = { ok: "✔", note: "•", warning: "⚠", problem: "✘" };
const AXLES = { tractor: 150, implement: 310 }; // in the drawing, where the right side of the rig is up
const MIDDLE = 84;
const ANTENNAS = { tractor_front: [72, 72], tractor_rear: [136, 72], implement_front: [246, 70], implement_rear: [326, 70] };
const byId = (id) => document.getElementById(id);

translatePage();
prepareSwitch(byId("language"));
const dark = matchMedia("(prefers-color-scheme: dark)");
const colour = () => { document.documentElement.dataset.theme = dark.matches ? "dark" : "light"; };
dark.addEventListener("change", colour);
colour();

const form = byId("form"), sections = [...form.querySelectorAll("section")];
const answers = { "wheel.way": "stops", ...kept() };
let heard = { buses: [], receivers: [], wheels: [], problems: [], without: [] };
let step = 0, cards = "";

function kept() {
  try {
    return JSON.parse(localStorage.getItem(KEPT)) ?? {};
  } catch {
    return {};
  }
}

function keep(name, value) {
  answers[name] = value;
  try {
    localStorage.setItem(KEPT, JSON.stringify(answers));
  } catch { /* then only until the page is closed */ }
}

async function ask(path, sent) {
  const options = sent && { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(sent) };
  const answer = await fetch(path, options);
  if (answer.status === 403) location.reload(); // the server is another one by now: it asks for the code
  return answer.json();
}

// Fields.

function select(name, options, chosen) {
  const made = element("select");
  made.name = name;
  for (const [value, text] of options) made.append(new Option(word(text), value));
  made.value = answers[name] ?? chosen;
  if (made.selectedIndex < 0) made.value = chosen;
  keep(name, made.value);
  return made;
}

function input(name, kind) {
  const made = element("input");
  Object.assign(made, { name, value: answers[name] ?? "", inputMode: kind ?? "decimal", autocapitalize: "off", spellcheck: false });
  return made;
}

function wrongOf(name) {
  const made = element("p", "wrong");
  made.dataset.wrong = name;
  made.id = `wrong-${name}`;
  return made;
}

function prepareFields() {
  for (const fieldset of form.querySelectorAll("fieldset[data-field]")) {
    const { field, unit, how, kind } = fieldset.dataset;
    const line = element("div", unit ? "entry" : "entry wide"), one = input(field, kind);
    const title = fieldset.firstChild.data.trim();
    one.setAttribute("aria-label", unit ? `${title}, ${unit}` : title);
    one.setAttribute("aria-describedby", `wrong-${field}`);
    line.append(one);
    if (unit) line.append(element("span", "", unit));
    if (how) {
      const known = select(`${field}.how`, HOW[how], how === "length" ? "tape" : "sheet");
      known.setAttribute("aria-label", t`${title}: how you know it`);
      line.append(known);
    }
    fieldset.append(line, wrongOf(field));
  }
  for (const radio of form.querySelectorAll("[name='wheel.way']")) radio.checked = radio.value === answers["wheel.way"];
}

form.addEventListener("submit", (event) => event.preventDefault());
form.addEventListener("input", ({ target }) => {
  if (!target.name) return;
  keep(target.name, target.value);
  if (target.name.endsWith(".mount")) keep(`${target.name}.chosen`, "yes");
  put(form.querySelector(`[data-wrong="${CSS.escape(target.name)}"]`) ?? document.createElement("p"), "");
  target.removeAttribute("aria-invalid");
  showPlaces();
});
form.addEventListener("focusin", ({ target }) => light(target.name));
form.addEventListener("keydown", (event) => {
  if (event.key === "Enter" && event.target.tagName === "INPUT") event.target.blur();
});

// The drawing.

function light(name = "") {
  const field = name.replace(/\.how$/, "");
  for (const one of byId("figure").querySelectorAll("[data-dim]")) one.toggleAttribute("data-lit", one.dataset.dim === field);
}

function shape(kind, attributes, text) {
  const made = document.createElementNS(SVG, kind);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  if (text) made.textContent = text;
  return made;
}

function drawAntennas() {
  byId("antennas").replaceChildren(...heard.receivers.flatMap(({ who }, i) => {
    const mount = answers[`${who}.mount`], [x, y] = ANTENNAS[mount] ?? [];
    if (!mount) return [];
    const axle = AXLES[mount.split("_")[0]], group = shape("g", { class: "antenna" });
    const ahead = shape("g", { "data-dim": `${who}.ahead` }), right = shape("g", { "data-dim": `${who}.right` });
    ahead.append(shape("path", { d: `M${axle} ${MIDDLE}V20M${x} ${y}V20M${axle} 26H${x}` }));
    right.append(shape("path", { d: `M${x} ${MIDDLE}V${y}` }));
    const height = shape("g", { "data-dim": `${who}.height` });
    height.append(shape("path", { d: `M${x - 11} ${y}a11 11 0 1 0 22 0a11 11 0 1 0 -22 0` }));
    group.append(ahead, right, height, shape("circle", { cx: x, cy: y, r: 6 }), shape("text", { x: x + 8, y: y - 6 }, i + 1));
    return [group];
  }));
}

// What is heard.

function showBuses() {
  const rows = heard.buses.map((bus) => {
    const rate = t`${bus.bitrate / 1000} kbit/s`;
    const row = element("li", "", `${bus.heard ? "✔" : "…"} ${bus.channel} · ${bus.heard ? rate : word("nothing heard yet")}`);
    row.dataset.state = bus.heard ? "good" : "";
    return row;
  });
  for (const problem of heard.problems) {
    const row = element("li", "", `✘ ${problem}`);
    row.dataset.state = "bad";
    rows.push(row);
  }
  if (!rows.length) rows.push(element("li", "", word("This computer has no CAN interface: plug in the adapter, then listen again.")));
  byId("buses").replaceChildren(...rows);
  const { receivers, devices, frames, seconds, wheels, listens } = heard;
  const told = frames ? t`${frames} frames in ${seconds} s: ${devices} devices, ${receivers.length} of them receivers with a position; ${wheels.length} possible wheel angles.` : "";
  const without = heard.without.length ? t`${heard.without.length} receivers have no position yet: wait for the sky.` : "";
  put(byId("heard-told"), [told, without, listens === false && frames ? word("Listening has stopped.") : ""].join(" "));
}

function showReceivers() {
  const whose = JSON.stringify(heard.receivers.map(({ who }) => who));
  for (const one of heard.receivers) {
    if (one.mount && !answers[`${one.who}.mount.chosen`]) keep(`${one.who}.mount`, one.mount);
  }
  const proposed = heard.receivers.some(({ mount }) => mount);
  byId("nameless").hidden = heard.receivers.every(({ name }) => name);
  byId("proposed").hidden = !proposed;
  byId("not-proposed").hidden = proposed;
  if (whose !== cards) {
    cards = whose;
    byId("receivers").replaceChildren(...heard.receivers.map(card));
  }
  for (const { who } of heard.receivers) form.elements[`${who}.mount`].value = answers[`${who}.mount`] ?? "";
  showPlaces();
}

function card({ who, source, name, maker, per_s, corrected, bus }, i) {
  const made = element("li");
  made.dataset.who = who;
  const named = name ? ` · ${name}` : "";
  made.append(element("h3", "", `${i + 1} · ${maker || word("maker not known")}`));
  made.append(element("small", "", t`address ${source} on ${bus}${named}, ${per_s} messages a second`));
  const mount = labelled("Mounted", select(`${who}.mount`, [["", "not used"], ...MOUNTS.map((one) => [one, capital(spaced(one))])], ""));
  const parts = element("div", "three");
  for (const [part, title] of PARTS) {
    const one = labelled(title, input(`${who}.${part}`));
    one.dataset.part = part;
    parts.append(one);
  }
  const where = element("div", "cards");
  where.append(parts, wrongOf(`${who}.ahead`), labelled("How you know it", select(`${who}.how`, HOW.length, "tape")));
  where.append(labelled("It reports the point on the ground, not the antenna", select(`${who}.corrected`, [["no", "no, or not known"], ["yes", "yes: terrain compensation is on"]], corrected ? "yes" : "no")));
  if (!name) where.append(labelled("Maker", select(`${who}.maker`, MAKERS, "")));
  made.append(mount, wrongOf(`${who}.mount`), where);
  return made;
}

function labelled(text, control) {
  const made = element("label", "line");
  made.append(element("span", "", word(text)), control);
  return made;
}

function showPlaces() {
  for (const made of byId("receivers").children) {
    const mount = answers[`${made.dataset.who}.mount`];
    made.toggleAttribute("data-placed", Boolean(mount));
    made.querySelector("div.cards").hidden = !mount;
    put(made.querySelector("[data-part=ahead] span"), `${word(mount?.startsWith("implement") ? "ahead of its axle" : "ahead of the rear axle")}, m`);
    for (const [part, title] of PARTS.slice(1)) put(made.querySelector(`[data-part=${part}] span`), `${word(title)}, m`);
  }
  const chosen = heard.wheels.find(({ which }) => which === answers.wheel);
  byId("scaled").hidden = !chosen || chosen.rudder;
  for (const one of form.querySelectorAll("[data-way]")) one.hidden = one.dataset.way !== answers["wheel.way"];
  drawAntennas();
}

function showWheels() {
  const { wheels } = heard;
  byId("no-wheel").hidden = wheels.length > 0;
  if (!answers.wheel && wheels[0]?.likely) keep("wheel", wheels[0].which);
  const focused = document.activeElement?.value;
  byId("wheels").replaceChildren(...wheels.map(({ which, words, likely }) => {
    const label = element("label"), radio = element("input"), text = element("span", "", words);
    Object.assign(radio, { type: "radio", name: "wheel", value: which, checked: which === answers.wheel });
    if (likely) text.prepend(element("b", "", `${word("likely")}: `));
    label.append(radio, text);
    return label;
  }));
  for (const radio of byId("wheels").querySelectorAll("input")) if (radio.value === focused) radio.focus();
}

async function hear() {
  try {
    heard = await ask("/setup/heard");
    byId("lost").hidden = true;
    showBuses();
    showWheels();
    showReceivers();
  } catch {
    byId("lost").hidden = false;
  }
  setTimeout(hear, document.hidden ? 5 * ASK_MS : ASK_MS);
}

// Check and save.

// As the server knows them: receivers by number.
function sent() {
  const all = {};
  for (const [name, value] of Object.entries(answers)) {
    if (!/^\w+ \d+/.test(name)) all[name] = value;
  }
  heard.receivers.forEach(({ who }, i) => {
    all[`receiver.${i}.who`] = who;
    for (const part of ["mount", "ahead", "right", "height", "how", "corrected", "maker"]) all[`receiver.${i}.${part}`] = answers[`${who}.${part}`] ?? "";
  });
  return all;
}

function fieldOf(name) {
  const [, number, part] = /^receiver\.(\d+)\.(\w+)$/.exec(name) ?? [];
  return number === undefined ? name : `${heard.receivers[number]?.who}.${part}`;
}

function showWrong(wrong, rare) {
  for (const one of form.querySelectorAll(".wrong")) put(one, "");
  for (const one of form.querySelectorAll("[aria-invalid]")) one.removeAttribute("aria-invalid");
  for (const button of byId("steps").querySelectorAll("button")) button.removeAttribute("data-wrong");
  for (const [rows, isRare] of [[rare, true], [wrong, false]]) {
    for (const [name, text] of rows.toReversed()) {
      const field = fieldOf(name), shown = field.replace(/\.(right|height|how)$/, (part) => (/^\w+ \d+/.test(field) ? ".ahead" : part));
      const place = form.querySelector(`[data-wrong="${CSS.escape(shown)}"]`);
      if (!place) continue;
      put(place, text);
      place.toggleAttribute("data-rare", isRare);
      if (isRare) continue;
      form.elements[field]?.setAttribute?.("aria-invalid", "true");
      byId("steps").children[sections.indexOf(place.closest("section"))].firstChild.dataset.wrong = "";
    }
  }
  byId("wrongs").replaceChildren(...wrong.map(([name, text]) => {
    const row = element("li"), place = form.querySelector(`[data-wrong="${CSS.escape(fieldOf(name))}"]`);
    row.append(element("b", "", `${place ? word(place.closest("section").dataset.step) : "✘"}: `), text);
    return row;
  }));
}

async function check() {
  const told = byId("checking");
  byId("save").hidden = byId("saved").hidden = byId("file").hidden = byId("passing").hidden = true;
  byId("checks").replaceChildren();
  byId("check").disabled = true;
  put(told, word("Checking: listening to the buses for a few seconds …"));
  try {
    const { wrong, rare = [], checks = [], ok, text = "" } = await ask("/setup/check", sent());
    showWrong(wrong, rare);
    for (const [list, wanted] of [["checks", false], ["passed", true]]) {
      byId(list).replaceChildren(...checks.filter(({ state }) => (state === "ok") === wanted).map((one) => {
        const row = element("li", "", `${SIGNS[one.state]} ${one.what}: ${one.text}`);
        row.dataset.state = one.state;
        return row;
      }));
    }
    byId("passing").hidden = !byId("passed").children.length;
    put(told, word(wrong.length ? "Something is missing or impossible:" : ok ? "✔ No problems found." : "You can save it, but something is wrong:"));
    put(byId("text"), text);
    put(byId("save"), word(ok ? "Save" : "Save anyway"));
    byId("save").hidden = wrong.length > 0;
    byId("file").hidden = !text;
  } catch {
    put(told, word("No answer; please try again."));
  }
  byId("check").disabled = false;
}

async function save() {
  byId("save").disabled = true;
  try {
    const { wrong, rare = [], saved, kept: before, recording } = await ask("/setup/save", sent());
    showWrong(wrong, rare);
    if (saved) {
      const rows = [t`✔ Saved: ${saved}`];
      if (before) rows.push(t`The previous file is kept: ${before}`);
      rows.push(word(recording ? "The run being recorded continues. The new file is used once it has ended." : "The recorder uses it when it starts; as a service it starts by itself within a minute."));
      const link = element("a", "", word("Open the live page"));
      link.href = "/";
      byId("saved").replaceChildren(...rows.map((text) => element("p", "", text)), link);
    }
    byId("saved").hidden = !saved;
    byId("save").hidden = Boolean(saved);
  } catch {
    put(byId("checking"), word("No answer; please try again."));
  }
  byId("save").disabled = false;
}

// Steps.

function go(to) {
  step = Math.max(0, Math.min(sections.length - 1, to));
  sections.forEach((section, i) => { section.hidden = i !== step; });
  [...byId("steps").querySelectorAll("button")].forEach((button, i) => {
    if (i === step) button.setAttribute("aria-current", "step");
    else button.removeAttribute("aria-current");
  });
  byId("figure").hidden = !["Receivers", "Lengths", "Masses"].includes(sections[step].dataset.step);
  byId("back").disabled = step === 0;
  byId("next").disabled = step === sections.length - 1;
  light();
  scrollTo(0, 0);
  document.documentElement.style.setProperty("--head", `${document.querySelector("header").offsetHeight}px`);
  if (step === sections.length - 1) check();
}

prepareFields();
byId("steps").append(...sections.map((section, i) => {
  const item = element("li"), button = element("button", "", word(section.dataset.step));
  button.type = "button";
  button.addEventListener("click", () => go(i));
  item.append(button);
  return item;
}));
byId("back").addEventListener("click", () => go(step - 1));
byId("next").addEventListener("click", () => go(step + 1));
byId("check").addEventListener("click", check);
byId("save").addEventListener("click", save);
byId("listen").addEventListener("click", () => ask("/setup/listen", {}).catch(() => {}));
go(0);
hear();

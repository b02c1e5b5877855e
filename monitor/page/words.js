// What things are called and how numbers are written. Nothing here touches the page.

import { said, t, word } from "./language.js";

export const PARAMETERS = [
  { name: "C_af", title: "Front tyres", unit: "kN/rad", scale: 1e-3, digits: 0 },
  { name: "C_ar", title: "Rear tyres", unit: "kN/rad", scale: 1e-3, digits: 0 },
  { name: "C_ai", title: "Implement tyres", unit: "kN/rad", scale: 1e-3, digits: 0 },
  { name: "sigma_f", title: "Front relaxation length", unit: "m", scale: 1, digits: 2 },
  { name: "sigma_r", title: "Rear relaxation length", unit: "m", scale: 1, digits: 2 },
  { name: "sigma_i", title: "Implement relaxation length", unit: "m", scale: 1, digits: 2 },
];
export const STATUSES = ["no estimate", "estimated", "stale", "invalid"];
const STATUS_STATES = ["unknown", "good", "warn", "bad"];
export const OLD_S = { pose: 2, status: 3, soil_tire: 3, experiment: 2, calibration: 3 }; // status and estimate come each second

export const known = (value) => value !== undefined && value !== null;
export const spaced = (word) => String(word ?? "").replaceAll("_", " ");
export const capital = (word) => word.charAt(0).toUpperCase() + word.slice(1);

export function time(seconds) {
  if (!known(seconds)) return "?";
  if (seconds < 10) return `${seconds.toFixed(Number.isInteger(seconds) ? 0 : 1)} s`;
  if (seconds < 120) return `${Math.round(seconds)} s`;
  if (seconds < 7200) return `${Math.round(seconds / 60)} min`;
  return `${Math.round(seconds / 3600)} h`;
}

export function duration(seconds) {
  const whole = Math.max(0, Math.floor(seconds));
  const two = (n) => String(n).padStart(2, "0");
  return `${Math.floor(whole / 3600)}:${two(Math.floor(whole / 60) % 60)}:${two(whole % 60)}`;
}

export function clock(t_ns) {
  const at = new Date(t_ns / 1e6);
  return Number.isNaN(at.getTime()) ? "" : at.toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", second: "2-digit", hour12: false });
}

export function hours(value) {
  if (!known(value)) return "–";
  if (value > 99) return "> 99 h";
  return value < 2 ? `${Math.round(value * 60)} min` : `${value.toFixed(value < 10 ? 1 : 0)} h`;
}

// Value and 95 % interval of what has a value and the half-width of its logarithm's; null where it has none.
export function interval(row, which) {
  if (!known(row.value) || !known(row.within)) return null;
  const factor = Math.exp(row.within), value = row.value * which.scale;
  return { value, low: value / factor, high: value * factor };
}

export function flagged(flag) {
  const [kind, ...of] = flag.split(":");
  return kind === "contradiction" ? t`contradicts the machine file: ${of.join(":")}` : `${word(spaced(kind))} ${word(spaced(of.join(" ")))}`.trim();
}

// What is said of the recorded drive that is shown while the daemon of a demo gets ready.
export function firstDrive({ preparing: doing, ready_in_s, recording }) {
  const left = known(ready_in_s) ? t`, about ${time(Math.round(ready_in_s))} left` : "";
  const now = doing ? ` (${doing}${left})` : "";
  return t`This is a recorded simulated drive, shown while this computer gets ready${now}.` + (recording ? ` ${word("Your own demo is already being recorded.")}` : "");
}

// What the daemon still makes ready. `age_s`: of what it said about that.
export function preparing({ preparing, ready_in_s, recording }, age_s) {
  const left = known(ready_in_s) ? ready_in_s - (age_s ?? 0) : undefined;
  const when = !known(left) ? "" : left < 1 ? word(", ready at any moment") : t`, about ${time(Math.round(left))} left`;
  return `${capital(preparing)}${when}. ${word(recording ? "Frames are already being recorded; results will follow." : "Results will follow.")}`;
}

// Of parameter i: what stands above its trace. `old`: how old the estimate as a whole is, if it is too old.
export function told({ parameters }, shown, i, old, age_s) {
  const which = PARAMETERS[i], status = shown.status[i], stale = status === 1 && old;
  const range = interval({ value: shown.value[i], within: shown.within[i] }, which);
  const number = (value) => value.toFixed(which.digits);
  const age = parameters[i].age_s;
  return {
    value: range ? `${number(range.value)} ${which.unit}` : `– ${which.unit}`,
    range: range ? t`${number(range.low)} to ${number(range.high)}` : "",
    status: word(stale ? "stale" : STATUSES[status]),
    state: stale ? "warn" : STATUS_STATES[status],
    why: [
      stale ? t`no estimate for ${time(age_s)}` : said(shown, "why")[i],
      known(age) ? t`last informed by data ${time(age + (age_s ?? 0))} ago` : "",
    ].filter(Boolean).join("; "),
  };
}

// What things are called and how numbers are written. Nothing here touches the page.

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
export const WITHIN = 1.96; // sd, of 95 %
export const OLD_S = 3; // an estimate comes each second

export const known = (value) => value !== undefined && value !== null;
export const spaced = (word) => String(word ?? "").replaceAll("_", " ");
export const capital = (word) => word.charAt(0).toUpperCase() + word.slice(1);

export function time(seconds) {
  if (!known(seconds)) return "?";
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
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

// How sure a logarithm of that sd is, in the words of the daemon's advice: one standard deviation.
export function share(log_sd) {
  const percent = 100 * log_sd;
  return percent > 100 ? "" : `±${percent.toFixed(percent >= 9.5 ? 0 : 1)} %`;
}

// Value and 95 % interval of a parameter whose logarithm has that sd; null where there is none.
export function interval(row, log_sd, which) {
  if (!known(row.value) || !known(log_sd)) return null;
  const factor = Math.exp(WITHIN * log_sd), value = row.value * which.scale;
  return { value, low: value / factor, high: value * factor };
}

// The sd of the logarithm of an estimate's parameter i; null where there is none.
export function spread(estimate, i) {
  const row = estimate.parameters[i] ?? {}, variance = estimate.log_covariance[7 * i];
  if (variance > 0) return Math.sqrt(variance);
  return known(row.value) && known(row.sd) ? row.sd / row.value : null;
}

// Of parameter i: what stands above its trace. `age_s`: of the estimate as a whole.
export function told(estimate, i, age_s) {
  const row = estimate.parameters[i] ?? {}, which = PARAMETERS[i];
  const status = row.status in STATUSES ? row.status : 3;
  const old = status === 1 && (!known(age_s) || age_s > OLD_S);
  const range = interval(row, spread(estimate, i), which);
  const number = (value) => value.toFixed(which.digits);
  return {
    value: range ? `${number(range.value)} ${which.unit}` : `– ${which.unit}`,
    range: range ? `${number(range.low)} to ${number(range.high)}` : "",
    status: old ? "stale" : STATUSES[status],
    state: old ? "warn" : STATUS_STATES[status],
    why: [
      old ? `no estimate for ${time(age_s)}` : row.reason,
      known(row.age_s) ? `data last told of it ${time(row.age_s + (age_s ?? 0))} ago` : "",
    ].filter(Boolean).join("; "),
  };
}

// Six parameters over time, each with its 95 % band, what was assumed before, and the events.

import { element, put } from "./tiles.js";
import { clock, interval, known, PARAMETERS, told } from "./words.js";

const HEIGHT = 170; // as in page.css
const LEAST_S = 30; // that is shown
const STRONG = new Set(["soil_change", "reset", "contradiction"]);
const MARKED = new Set([...STRONG, "lost", "mark", "gap", "fault", "clock_step"]);

export class Traces {
  constructor(container) {
    this.seconds = 300;
    this.events = [];
    this.clear();
    this.plots = PARAMETERS.map((which, i) => this.#make(container, which, i));
    this.recolour();
  }

  clear() {
    this.t = [];
    this.rows = PARAMETERS.map(() => ({ now: [], old: [], high: [], low: [] }));
  }

  setAll({ t, value, within, status }) {
    this.clear();
    t.forEach((at, i) => this.#push(at, value[i], within[i], status[i]));
    this.draw();
  }

  // Further estimates.
  add({ t, value, within, status }) {
    t.forEach((at, i) => this.#push(at, value[i], within[i], status[i]));
    this.draw();
  }

  // First and last that are shown, s.
  get times() {
    return this.#times();
  }

  #push(t, value, within, status) {
    this.t.push(t);
    this.rows.forEach((row, i) => {
      const found = interval({ value: value[i], within: within[i] }, PARAMETERS[i]);
      row.now.push(found && status[i] === 1 ? found.value : null);
      row.old.push(found && status[i] !== 1 ? found.value : null);
      row.high.push(found ? found.high : null);
      row.low.push(found ? found.low : null);
    });
  }

  setPriors(rig) {
    this.priors = PARAMETERS.map((which) => {
      const prior = (rig.priors ?? []).find((one) => one.name === which.name);
      return prior ? interval(prior, which) : null;
    });
    this.draw();
  }

  setEvents(events) {
    this.events = events.filter((event) => MARKED.has(event.kind) && event.notice?.code !== "over");
    this.draw();
  }

  range(seconds) {
    this.seconds = seconds;
    this.draw();
  }

  // What stands above each plot.
  tell(estimate, shown, old, age_s) {
    this.plots.forEach((one, i) => {
      const words = told(estimate, shown, i, old, age_s);
      put(one.value, words.value);
      put(one.range, words.range);
      put(one.status, words.status);
      one.status.dataset.state = words.state;
      put(one.why, words.why);
    });
  }

  forget() {
    for (const [i, one] of this.plots.entries()) {
      put(one.value, `– ${PARAMETERS[i].unit}`);
      for (const place of [one.range, one.why]) put(place, "");
      put(one.status, "no estimate");
      one.status.dataset.state = "unknown";
    }
  }

  draw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.plots?.forEach((one, i) => {
        const row = this.rows[i];
        one.plot.setData([this.t, row.high, row.low, row.now, row.old]);
      });
    });
  }

  recolour() {
    const style = getComputedStyle(document.documentElement);
    this.colours = Object.fromEntries(["ink", "grid", "trace", "band", "prior", "event", "quiet"].map((name) => [name, style.getPropertyValue(`--${name}`)]));
    this.plots?.forEach((one) => one.plot.redraw());
  }

  #make(container, which, i) {
    const box = element("article", "trace"), head = element("div", "trace-head"), frame = element("div", "trace-plot");
    const [value, status] = [element("span", "trace-value now", `– ${which.unit}`), element("span", "trace-status", "no estimate")];
    const range = element("span", "trace-range now"), why = element("p", "trace-why");
    const title = element("h3", "", which.title), name = element("span", "quiet", which.name);
    const words = element("div", "trace-head");
    head.append(title, name);
    words.append(value, range, status);
    box.append(head, words, why, frame);
    container.append(box);
    const colour = (key) => () => this.colours?.[key] ?? "";
    const axis = { stroke: colour("ink"), grid: { stroke: colour("grid"), width: 1 }, ticks: { stroke: colour("grid") }, font: "12px system-ui, sans-serif" };
    const plot = new uPlot({
      width: Math.max(200, frame.clientWidth), height: HEIGHT,
      legend: { show: false }, cursor: { show: false },
      scales: { x: { time: true, range: () => this.#times() }, y: { range: (u, low, high) => this.#values(i, low, high) } },
      axes: [{ ...axis, space: 50, size: 28, values: (u, at) => at.map((t) => clock(t * 1e9).slice(0, u.scales.x.max - u.scales.x.min > 180 ? 5 : 8)) }, { ...axis, size: 48 }],
      series: [
        {},
        { stroke: "transparent", points: { show: false } },
        { stroke: "transparent", points: { show: false } },
        { stroke: colour("trace"), width: 2.5, points: { show: false } },
        { stroke: colour("quiet"), width: 2, dash: [6, 4], points: { show: false } },
      ],
      bands: [{ series: [1, 2], fill: colour("band") }],
      hooks: { drawAxes: [(u) => this.#behind(u, i)] },
    }, [[], [], [], [], []], frame);
    new ResizeObserver(() => plot.setSize({ width: Math.max(120, frame.clientWidth), height: HEIGHT })).observe(frame);
    return { plot, value, range, status, why };
  }

  #times() {
    const last = this.t.at(-1) ?? Date.now() / 1000;
    const first = Math.min(this.t[0] ?? last, last - LEAST_S); // it grows with the run
    return [this.seconds ? Math.max(first, last - this.seconds) : first, last];
  }

  // So that the estimate fills the height; without one, what was assumed before.
  #values(i, low, high) {
    const prior = this.priors?.[i];
    if (!known(low) || !known(high)) return prior ? [0.8 * prior.low, 1.1 * prior.high] : [0, 1];
    const spare = Math.max(0.15 * (high - low), 0.03 * high);
    return [Math.max(0, low - spare), high + spare];
  }

  #behind(u, i) {
    const { ctx, bbox } = u, prior = this.priors?.[i], dots = devicePixelRatio || 1;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    if (prior) {
      ctx.strokeStyle = this.colours.prior;
      ctx.lineWidth = 1.5 * dots;
      for (const [v, dash] of [[prior.low, [2, 4]], [prior.value, [8, 5]], [prior.high, [2, 4]]]) {
        ctx.setLineDash(dash.map((length) => length * dots));
        const y = u.valToPos(v, "y", true);
        stroke(ctx, bbox.left, y, bbox.left + bbox.width, y);
      }
    }
    ctx.setLineDash([]);
    ctx.strokeStyle = this.colours.event;
    for (const event of this.events) {
      ctx.lineWidth = (STRONG.has(event.kind) ? 4 : 1.5) * dots;
      const x = u.valToPos(event.t_ns * 1e-9, "x", true);
      stroke(ctx, x, bbox.top, x, bbox.top + bbox.height);
    }
    ctx.restore();
  }
}

function stroke(ctx, ...[x0, y0, x1, y1]) {
  ctx.beginPath();
  ctx.moveTo(x0, y0);
  ctx.lineTo(x1, y1);
  ctx.stroke();
}

// The angle of the front wheels over time, above what is estimated from it.

import { word } from "./language.js";
import { element } from "./tiles.js";
import { clock, known } from "./words.js";

const HEIGHT = 110; // as in page.css
const LEAST_DEG = 5; // of the scale, to either side

export class Steering {
  // times: first and last that the traces below show.
  constructor(container, times) {
    this.times = times;
    this.clear();
    const head = element("h3", "", word("Steering"));
    head.append(element("span", "quiet", ` ${word("wheel angle in degrees, right positive")}`));
    const frame = element("div", "steering-plot");
    container.append(head, frame);
    const colour = (key) => () => this.colours?.[key] ?? "";
    const axis = { stroke: colour("ink"), grid: { stroke: colour("grid"), width: 1 }, ticks: { stroke: colour("grid") }, font: "12px system-ui, sans-serif" };
    this.plot = new uPlot({
      width: Math.max(200, frame.clientWidth), height: HEIGHT,
      legend: { show: false }, cursor: { show: false },
      scales: { x: { time: true, range: () => this.times() }, y: { range: (u, low, high) => limits(low, high) } },
      axes: [{ ...axis, space: 90, size: 28, values: (u, at) => at.map((t) => clock(t * 1e9).slice(0, u.scales.x.max - u.scales.x.min > 900 ? 5 : 8)) }, { ...axis, size: 48, space: 18 }],
      series: [{}, { stroke: colour("trace"), width: 2, points: { show: false } }],
    }, [[], []], frame);
    new ResizeObserver(() => this.plot.setSize({ width: Math.max(120, frame.clientWidth), height: HEIGHT })).observe(frame);
    this.recolour();
  }

  clear() {
    this.t = [];
    this.degrees = [];
  }

  setAll(rows) {
    this.clear();
    this.add(rows);
    this.draw();
  }

  add({ t, wheel_angle }) {
    t.forEach((at, i) => {
      this.t.push(at);
      this.degrees.push(known(wheel_angle[i]) ? (wheel_angle[i] * 180) / Math.PI : null);
    });
    this.draw();
  }

  draw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.plot?.setData([this.t, this.degrees]);
    });
  }

  recolour() {
    const style = getComputedStyle(document.documentElement);
    this.colours = Object.fromEntries(["ink", "grid", "trace"].map((name) => [name, style.getPropertyValue(`--${name}`)]));
    this.plot?.redraw();
  }
}

function limits(low, high) {
  const widest = Math.max(LEAST_DEG, Math.abs(low ?? 0), Math.abs(high ?? 0));
  return [-1.1 * widest, 1.1 * widest];
}

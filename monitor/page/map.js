// The field from above, north up, in metres: both bodies to scale, antennas, and the track by its quality.

import { known } from "./words.js";

const COLOURS = ["panel", "ink", "grid", "bad", "tractor", "implement", "q0", "q1", "q2"];
const CLOSEST = 120, FARTHEST = 0.02; // pixels per metre
// Lengths are those of the machine file. It tells no widths: these are usual ones.
const TRACK = 1.9, REAR_WHEEL = [1.9, 0.6], FRONT_WHEEL = [1.4, 0.45], CART_WHEEL = [1.7, 0.6], CART_WIDTH = 2.6;

const noTrack = () => ({ t: [], tractor: [], implement: [], quality: [] });

export class FieldMap {
  constructor(canvas, onFollow) {
    this.canvas = canvas;
    this.onFollow = onFollow;
    this.centre = [0, 0]; // north, east
    this.scale = 12;
    this.following = true;
    this.track = noTrack();
    this.pointers = new Map();
    this.drawing = false;
    this.recolour();
    this.#listen();
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  recolour() {
    const style = getComputedStyle(document.documentElement);
    this.colours = Object.fromEntries(COLOURS.map((name) => [name, style.getPropertyValue(`--${name}`)]));
    this.draw();
  }

  setTrack(track = noTrack()) { // what a browser has kept has none
    this.track = track;
    this.draw();
  }

  addTrack(rows) {
    for (const [name, column] of Object.entries(this.track)) column.push(...rows[name]);
    this.draw();
  }

  setPose(pose) {
    this.pose = pose;
    this.draw();
  }

  // Whether what is drawn is no longer so.
  setOld(old) {
    if (old !== this.old) this.draw();
    this.old = old;
  }

  follow(on) {
    this.following = on;
    this.onFollow(on);
    this.draw();
  }

  zoom(factor, x, y) {
    const before = this.#world(x, y);
    this.scale = Math.min(CLOSEST, Math.max(FARTHEST, this.scale * factor));
    if (!this.following && x !== undefined) {
      const after = this.#world(x, y);
      this.centre = [this.centre[0] + before[0] - after[0], this.centre[1] + before[1] - after[1]];
    }
    this.draw();
  }

  fit() {
    const points = this.track.tractor.concat(this.track.implement).filter(Boolean);
    if (!points.length) return;
    const [n, e] = [points.map((p) => p[0]), points.map((p) => p[1])];
    const low = [n.reduce((a, b) => Math.min(a, b)), e.reduce((a, b) => Math.min(a, b))];
    const high = [n.reduce((a, b) => Math.max(a, b)), e.reduce((a, b) => Math.max(a, b))];
    this.follow(false);
    this.centre = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
    const { clientWidth: w, clientHeight: h } = this.canvas;
    this.scale = Math.min(CLOSEST, w / (high[1] - low[1] + 15), h / (high[0] - low[0] + 15));
    this.draw();
  }

  pan(x, y) {
    if (this.following) this.follow(false);
    this.centre = [this.centre[0] + y / this.scale, this.centre[1] - x / this.scale];
    this.draw();
  }

  draw() {
    if (this.drawing) return;
    this.drawing = true;
    requestAnimationFrame(() => {
      this.drawing = false;
      this.#paint();
    });
  }

  #world(x, y) {
    const { clientWidth: w, clientHeight: h } = this.canvas;
    return [this.centre[0] - ((y ?? h / 2) - h / 2) / this.scale, this.centre[1] + ((x ?? w / 2) - w / 2) / this.scale];
  }

  #paint() {
    const { canvas, pose } = this;
    const { clientWidth: w, clientHeight: h } = canvas;
    const dots = window.devicePixelRatio || 1;
    if (canvas.width !== Math.round(w * dots) || canvas.height !== Math.round(h * dots)) {
      canvas.width = Math.round(w * dots);
      canvas.height = Math.round(h * dots);
    }
    const body = known(pose?.tractor?.x) ? pose.tractor : pose?.implement;
    if (this.following && known(body?.x) && known(body?.y)) this.centre = [body.x, body.y];
    const colour = (name) => this.colours[name];
    const pen = canvas.getContext("2d");
    pen.setTransform(dots, 0, 0, dots, 0, 0);
    pen.fillStyle = colour("panel");
    pen.fillRect(0, 0, w, h);
    const at = ([n, e]) => [w / 2 + (e - this.centre[1]) * this.scale, h / 2 - (n - this.centre[0]) * this.scale];
    this.#grid(pen, w, h, at, colour);
    this.#tracks(pen, at, colour);
    if (pose && this.rig) {
      drawImplement(pen, pose, this.rig, at, this.scale, colour);
      drawTractor(pen, pose, this.rig, at, this.scale, colour);
      this.#antennas(pen, at, colour);
    }
    this.#ruler(pen, h, colour);
  }

  #grid(pen, w, h, at, colour) {
    const every = nice(80 / this.scale);
    const [top, left] = this.#world(0, 0), [bottom, right] = this.#world(w, h);
    pen.strokeStyle = colour("grid");
    pen.lineWidth = 1;
    pen.beginPath();
    for (let n = Math.ceil(bottom / every) * every; n <= top; n += every) {
      const y = Math.round(at([n, 0])[1]) + 0.5;
      pen.moveTo(0, y);
      pen.lineTo(w, y);
    }
    for (let e = Math.ceil(left / every) * every; e <= right; e += every) {
      const x = Math.round(at([0, e])[0]) + 0.5;
      pen.moveTo(x, 0);
      pen.lineTo(x, h);
    }
    pen.stroke();
  }

  #tracks(pen, at, colour) {
    const { tractor, implement, quality } = this.track;
    pen.lineJoin = "round";
    line(pen, implement, () => true, at, colour("implement"), 1, []);
    for (const [q, width, dash] of [[0, 2.5, []], [1, 3, [7, 4]], [2, 5, []]]) {
      line(pen, tractor, (i) => quality[i] === q, at, colour(`q${q}`), width, dash);
    }
  }

  #antennas(pen, at, colour) {
    for (const antenna of this.rig.antennas ?? []) {
      const body = antenna.mount.startsWith("tractor") ? this.pose.tractor : this.pose.implement;
      if (!known(body?.x) || !known(body?.heading)) continue;
      const [x, y] = at(onBody(body, antenna.forward, antenna.right));
      const alive = !this.receivers || this.receivers.find((r) => r.mount === antenna.mount)?.state === "alive";
      pen.fillStyle = alive || this.old ? colour("panel") : colour("bad");
      pen.strokeStyle = colour("ink");
      pen.lineWidth = 2;
      pen.beginPath();
      pen.arc(x, y, Math.max(3, Math.min(7, 0.2 * this.scale)), 0, 2 * Math.PI);
      pen.fill();
      pen.stroke();
    }
  }

  #ruler(pen, h, colour) {
    const metres = nice(90 / this.scale), length = metres * this.scale;
    pen.strokeStyle = pen.fillStyle = colour("ink");
    pen.lineWidth = 2;
    pen.beginPath();
    pen.moveTo(12, h - 18);
    pen.lineTo(12, h - 12);
    pen.lineTo(12 + length, h - 12);
    pen.lineTo(12 + length, h - 18);
    pen.stroke();
    pen.font = "600 13px system-ui, sans-serif";
    pen.fillText(metres >= 1000 ? `${metres / 1000} km` : `${metres} m`, 16, h - 18);
    pen.fillText("N", 12, 40);
    pen.beginPath();
    pen.moveTo(17, 10);
    pen.lineTo(11, 26);
    pen.lineTo(17, 22);
    pen.lineTo(23, 26);
    pen.fill();
  }

  #listen() {
    const { canvas, pointers } = this;
    const spread = () => {
      const [a, b] = [...pointers.values()];
      return Math.hypot(a.x - b.x, a.y - b.y);
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
    });
    canvas.addEventListener("pointermove", (event) => {
      const last = pointers.get(event.pointerId);
      if (!last) return;
      const before = pointers.size === 2 ? spread() : 0;
      const [x, y] = [event.offsetX - last.x, event.offsetY - last.y];
      pointers.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
      if (pointers.size === 1) this.pan(x, y);
      else if (pointers.size === 2 && before > 0) {
        this.pan(x / 2, y / 2);
        const [a, b] = [...pointers.values()];
        this.zoom(spread() / before, (a.x + b.x) / 2, (a.y + b.y) / 2);
      }
    });
    for (const kind of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(kind, (event) => pointers.delete(event.pointerId));
    }
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * 0.0015), event.offsetX, event.offsetY);
    }, { passive: false });
    const keys = {
      ArrowLeft: () => this.pan(60, 0), ArrowRight: () => this.pan(-60, 0),
      ArrowUp: () => this.pan(0, 60), ArrowDown: () => this.pan(0, -60),
      "+": () => this.zoom(1.4), "=": () => this.zoom(1.4), "-": () => this.zoom(1 / 1.4),
      f: () => this.follow(!this.following), a: () => this.fit(),
    };
    canvas.addEventListener("keydown", (event) => {
      if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      keys[event.key]();
    });
  }
}

function nice(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((n) => n * power).find((n) => n >= least);
}

// A step from one point to the next belongs to the later one.
function line(pen, points, wanted, at, colour, width, dash) {
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.setLineDash(dash);
  pen.beginPath();
  let joined = false;
  for (let i = 1; i < points.length; i++) {
    if (!points[i] || !points[i - 1] || !wanted(i)) {
      joined = false;
      continue;
    }
    if (!joined) pen.moveTo(...at(points[i - 1]));
    pen.lineTo(...at(points[i]));
    joined = true;
  }
  pen.stroke();
  pen.setLineDash([]);
}

function onBody(body, forward, right) {
  const [cos, sin] = [Math.cos(body.heading), Math.sin(body.heading)];
  return [body.x + forward * cos - right * sin, body.y + forward * sin + right * cos];
}

function polygon(pen, body, at, corners, close = true) {
  pen.beginPath();
  corners.forEach(([f, r], i) => pen[i ? "lineTo" : "moveTo"](...at(onBody(body, f, r))));
  if (close) pen.closePath();
}

function wheel(pen, body, at, forward, right, [length, width], angle = 0) {
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  const corners = [[1, 1], [1, -1], [-1, -1], [-1, 1]].map(([i, j]) => {
    const [f, r] = [(i * length) / 2, (j * width) / 2];
    return [forward + f * cos - r * sin, right + f * sin + r * cos];
  });
  polygon(pen, body, at, corners);
  pen.fill();
}

function ready(pen, body, scale, colour, name) {
  if (!known(body?.x) || !known(body?.y) || !known(body?.heading)) return false;
  pen.strokeStyle = colour(name);
  pen.fillStyle = colour(name);
  pen.lineWidth = Math.max(2, 0.12 * scale);
  return true;
}

function drawTractor(pen, pose, rig, at, scale, colour) {
  const body = pose.tractor;
  if (!ready(pen, body, scale, colour, "tractor")) return;
  const { a, b, c } = rig, half = TRACK / 2;
  polygon(pen, body, at, [[-b, 0], [-c, 0]], false);
  pen.stroke();
  for (const side of [-half, half]) {
    wheel(pen, body, at, -b, side, REAR_WHEEL);
    wheel(pen, body, at, a, side, FRONT_WHEEL, pose.wheel_angle ?? 0);
  }
  polygon(pen, body, at, [[-b - 0.3, -0.75], [0.35, -0.75], [0.35, -0.4], [a + 0.7, -0.4], [a + 0.7, 0.4], [0.35, 0.4], [0.35, 0.75], [-b - 0.3, 0.75]]);
  pen.fillStyle = colour("panel");
  pen.fill();
  pen.stroke();
}

function drawImplement(pen, pose, rig, at, scale, colour) {
  const body = pose.implement;
  if (!ready(pen, body, scale, colour, "implement")) return;
  const { d, e } = rig, half = CART_WIDTH / 2, front = 0.55 * d;
  polygon(pen, body, at, [[front, -half * 0.6], [d, 0], [front, half * 0.6]], false);
  pen.stroke();
  for (const side of [-half, half]) wheel(pen, body, at, -e, side, CART_WHEEL);
  polygon(pen, body, at, [[front, -half + 0.2], [front, half - 0.2], [-e - front, half - 0.2], [-e - front, -half + 0.2]]);
  pen.fillStyle = colour("panel");
  pen.fill();
  pen.stroke();
}

// Panels of a figure that zoom together: Ctrl and wheel, buttons, or drag once zoomed in.
"use strict";

const SVG = "http://www.w3.org/2000/svg";
const MOST = 32, STEP = 2;

/** What a panel shows, in a frame of its own: the part that is clipped to it, not its scale and its titles. */
function framed(panel) {
  const clipped = [...panel.children].filter((child) => child.matches("[clip-path]") || child.querySelector("[clip-path]"));
  const id = (clipped[0].closest("[clip-path]") ?? clipped[0].querySelector("[clip-path]"))
    .getAttribute("clip-path").slice(5, -1);
  const clip = document.getElementById(id).querySelector("rect");
  const [x, y, w, h] = ["x", "y", "width", "height"].map((name) => Number(clip.getAttribute(name)));
  const frame = document.createElementNS(SVG, "svg");
  for (const [name, value] of Object.entries({ x, y, width: w, height: h, viewBox: `${x} ${y} ${w} ${h}` })) {
    frame.setAttribute(name, value);
  }
  frame.setAttribute("class", "frame");
  panel.insertBefore(frame, clipped[0]);
  frame.append(...clipped);
  return { frame, x, y, w, h };
}

function zooming(figure) {
  const panels = [...figure.querySelectorAll("[id*='-panel-']")].map(framed);
  const scale = figure.querySelector("[id$='-scale'] text");
  const length = Number.parseFloat(scale.textContent);
  let zoom = 1, left = 0, top = 0; // of all panels; the corner in shares of a panel
  const show = () => {
    const most = 1 - 1 / zoom;
    left = Math.min(Math.max(left, 0), most);
    top = Math.min(Math.max(top, 0), most);
    for (const { frame, x, y, w, h } of panels) {
      frame.setAttribute("viewBox", `${x + left * w} ${y + top * h} ${w / zoom} ${h / zoom}`);
      frame.style.touchAction = zoom > 1 ? "none" : "auto";
      frame.style.cursor = zoom > 1 ? "grab" : "auto";
    }
    scale.textContent = `${Number((length / zoom).toPrecision(3))} m`;
  };
  const zoomBy = (factor, across = 0.5, down = 0.5) => {
    const next = Math.min(Math.max(zoom * factor, 1), MOST);
    left += across * (1 / zoom - 1 / next);
    top += down * (1 / zoom - 1 / next);
    zoom = next;
    show();
  };
  const drawing = figure.querySelector("svg");
  for (const { frame, x, y, w, h } of panels) {
    const place = (event) => { // in shares of the panel
      const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(drawing.getScreenCTM().inverse());
      return [(at.x - x) / w, (at.y - y) / h];
    };
    let held = [0, 0];
    frame.addEventListener("wheel", (event) => {
      if (!event.ctrlKey) return; // the page scrolls
      event.preventDefault();
      zoomBy(event.deltaY < 0 ? STEP : 1 / STEP, ...place(event));
    }, { passive: false });
    frame.addEventListener("pointerdown", (event) => {
      frame.setPointerCapture(event.pointerId);
      held = place(event);
    });
    frame.addEventListener("pointermove", (event) => {
      if (!frame.hasPointerCapture(event.pointerId)) return;
      const [across, down] = place(event);
      left -= (across - held[0]) / zoom;
      top -= (down - held[1]) / zoom;
      held = [across, down];
      show();
    });
  }
  const bar = document.createElement("p");
  const actions = [["+", "Zoom in", () => zoomBy(STEP)], ["−", "Zoom out", () => zoomBy(1 / STEP)],
    ["Whole field", "Whole field", () => zoomBy(0)]];
  for (const [text, name, act] of actions) {
    const button = document.createElement("button");
    button.textContent = text;
    button.setAttribute("aria-label", name);
    button.addEventListener("click", act);
    bar.append(button, " ");
  }
  figure.prepend(bar);
}

for (const figure of document.querySelectorAll("figure:has([id*='-panel-'])")) zooming(figure);

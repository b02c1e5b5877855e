// The lengths a to e of the machine file, as a drawing with dimensions.

const SVG = "http://www.w3.org/2000/svg";
const ABOVE = 24, LINE = 44, BELOW = 66; // pixels from the top
const WIDTH = 400, EDGE = 36;

export function showLengths({ a, b, c, d, e }) {
  const drawing = document.getElementById("lengths"), share = (WIDTH - 2 * EDGE) / (a + c + d + e);
  const at = (behind) => WIDTH - EDGE - share * behind; // m behind the front axle
  const places = { front: 0, tractor: a, rear: a + b, hitch: a + c, implement: a + c + d, axle: a + c + d + e };
  drawing.setAttribute("viewBox", `0 0 ${WIDTH} 84`);
  const parts = [part("line", { x1: at(places.axle), x2: at(places.front), y1: LINE, y2: LINE })];
  for (const axle of ["front", "rear", "axle"]) parts.push(part("circle", { cx: at(places[axle]), cy: LINE, r: 9 }));
  for (const body of ["tractor", "implement"]) parts.push(part("circle", { cx: at(places[body]), cy: LINE, r: 3, class: "filled" }));
  parts.push(part("circle", { cx: at(places.hitch), cy: LINE, r: 4 }));
  const spans = [
    ["a", a, "tractor", "front", ABOVE], ["b", b, "rear", "tractor", ABOVE], ["c", c, "hitch", "tractor", BELOW],
    ["d", d, "implement", "hitch", ABOVE], ["e", e, "axle", "implement", ABOVE],
  ];
  for (const [name, metres, from, to, y] of spans) {
    const x1 = at(places[from]), x2 = at(places[to]);
    parts.push(part("path", { d: `M${x1} ${y - 4}v8M${x1} ${y}H${x2}M${x2} ${y - 4}v8` }));
    const text = part("text", { x: (x1 + x2) / 2, y: y < LINE ? y - 6 : y + 15 });
    text.textContent = `${name} ${metres.toFixed(2)} m`;
    parts.push(text);
  }
  drawing.replaceChildren(...parts);
  document.getElementById("lengths-part").hidden = false;
}

function part(kind, attributes) {
  const made = document.createElementNS(SVG, kind);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}

// The inner loop's curves: small pictures side by side, each with its own scale.

const SVG = "http://www.w3.org/2000/svg";
const [WIDTH, HEIGHT, LEFT, BOTTOM, EDGE] = [320, 150, 46, 20, 8];
const CURVES = [
  ["similarity", "Similarity ρ"],
  ["rkhs_distance", "RKHS distance d"],
  ["lengthscale", "Lengthscale ℓ, in the input's unit"],
];

export function drawConvergence(place, trace) {
  if (!trace.length) {
    place.textContent = "The inner loop took no step.";
    return;
  }
  place.replaceChildren(...CURVES.map(([name, title]) => curve(title, trace.map((step) => step[name]))));
}

function curve(title, values) {
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const span = high - low || Math.abs(high) || 1;
  const x = (k) => LEFT + ((WIDTH - LEFT - EDGE) * k) / Math.max(1, values.length - 1);
  const y = (value) => EDGE + (HEIGHT - BOTTOM - EDGE) * (1 - (value - low) / span);
  const svg = element("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img" });
  svg.setAttribute("aria-label", `${title}: from ${short(values[0])} to ${short(values.at(-1))} in ${values.length} iterations`);
  const base = HEIGHT - BOTTOM;
  svg.append(element("path", { class: "axis", d: `M${LEFT} ${EDGE}V${base}H${WIDTH - EDGE}`, fill: "none" }));
  svg.append(label(short(high), LEFT - 5, y(high) + 8, "end"));
  if (high > low) svg.append(label(short(low), LEFT - 5, y(low), "end"));
  svg.append(label("1", LEFT, HEIGHT - 5, "start"), label(`${values.length}`, WIDTH - EDGE, HEIGHT - 5, "end"));
  const path = values.map((value, k) => `${k ? "L" : "M"}${x(k).toFixed(1)} ${y(value).toFixed(1)}`).join("");
  svg.append(element("path", { class: "curve", d: path }));
  if (values.length <= 40) {
    values.forEach((value, k) => svg.append(element("circle", { class: "dot", cx: x(k), cy: y(value), r: 2.5 })));
  }
  const figure = document.createElement("figure");
  const caption = document.createElement("figcaption");
  caption.textContent = title;
  figure.append(caption, svg);
  return figure;
}

function element(name, attributes) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

function label(text, x, y, anchor) {
  const made = element("text", { x, y, "text-anchor": anchor });
  made.textContent = text;
  return made;
}

function short(value) { return Number(value.toPrecision(3)).toString(); }

// Numbers as text, small pieces of the page, and the ticks of the legend.
"use strict";

const MARK_PATHS = { disc: "M7 1a6 6 0 1 0 .01 0z", ring: "M7 1.5a5.5 5.5 0 1 0 .01 0z", diamond: "M7 .5L13.5 7 7 13.5.5 7z", square: "M2 2h10v10H2z", alarm: "M2 2h10v10H2z",
  cross: "M2 4L4 2l3 3 3-3 2 2-3 3 3 3-2 2-3-3-3 3-2-2 3-3z" };

/** A number with a fixed count of decimals, or a dash where it is not known; no minus before a zero. */
function fixed(value, decimals) {
  if (!Number.isFinite(value)) return "\u2013";
  const text = value.toFixed(decimals);
  return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "\u2212");
}

/** Decimals that show three digits of a length in mm, but no more than a hundredth of a micrometre. */
function millimetres(value) {
  const size = Math.abs(value);
  return fixed(value, size >= 100 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : size >= 0.1 ? 3 : size >= 0.001 ? 4 : 5);
}

function element(name, attributes = {}, ...children) {
  const node = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    node.setAttribute(key, value);
  }
  node.append(...children);
  return node;
}

/** An element of a drawing. */
function svgElement(name, attributes, ...children) {
  const node = document.createElementNS("http://www.w3.org/2000/svg", name);
  Object.entries(attributes).forEach(([key, value]) => node.setAttribute(key, value));
  node.append(...children);
  return node;
}

/** A row of a table. @param head the text of its first cell @param cells those of the others */
function tableRow(head, cells, attributes = {}) {
  return element("tr", attributes, element("th", { scope: "row" }, head), ...cells.map((text) => element("td", {}, text)));
}

/** The mark of a group, the cross of outliers, or the ring of the chosen pose, as an inline picture. */
function markPicture(mark) {
  const path = svgElement("path", { d: MARK_PATHS[mark],
    fill: { cross: "currentColor", alarm: "#d91414", ring: "transparent" }[mark] || "#9fb0c2",
    stroke: mark === "ring" ? "#cc0d59" : "currentColor", "stroke-width": mark === "cross" ? "0.5" : "1.6" });
  return svgElement("svg", { viewBox: "0 0 14 14", class: "mark", "aria-hidden": "true" }, path);
}

/** Round values between two limits and where they stand on the bar, 0 to 1. */
function ticksBetween(low, high, logarithmic) {
  const ticks = [];
  if (!(high > low)) return [[high, 0.5]];
  if (logarithmic) {
    const whole = Math.log10(high / low);
    const steps = whole > 2.4 ? [1] : whole > 1.2 ? [1, 3] : [1, 2, 5];
    for (let decade = Math.floor(Math.log10(low)); decade <= Math.ceil(Math.log10(high)); decade += 1) {
      for (const step of steps) {
        const value = step * 10 ** decade;
        const part = Math.log10(value / low) / whole;
        if (part >= 0 && part <= 1) ticks.push([value, part]);
      }
    }
    return ticks;
  }
  const rough = (high - low) / 5;
  const decade = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * decade).find((candidate) => candidate >= rough);
  for (let k = Math.ceil(low / step); k * step <= high; k += 1) {
    ticks.push([k * step, (k * step - low) / (high - low)]);
  }
  return ticks;
}

/** Draw a bar of colours. @param colours 256 x 4 bytes */
function drawBar(canvas, colours) {
  const context = canvas.getContext("2d");
  const image = context.createImageData(256, 1);
  image.data.set(colours);
  context.putImageData(image, 0, 0);
}

/** Ticks of a bar between two numbers. */
function tickMarks(low, high, logarithmic) {
  return ticksBetween(low, high, logarithmic).map(([value, part]) => {
    const tick = element("span", {}, String(Number(value.toPrecision(3))));
    tick.style.left = `${100 * part}%`;
    return tick;
  });
}

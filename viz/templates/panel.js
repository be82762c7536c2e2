// The panel: numbers of the chosen pose, legend and summary. It only reads the scene and writes text.
"use strict";

const KINDS = ["identification", "validation", "measured", "left out"]; // and 4 more: the same, outliers
const OUTLIERS = 4; // the mark and the switch of outliers
const MARK_PATHS = ["M7 1a6 6 0 1 0 .01 0z", "M7 .5L13.5 7 7 13.5.5 7z", "M2 2h10v10H2z", "M7 1a6 6 0 1 0 .01 0z", "M2 4L4 2l3 3 3-3 2 2-3 3 3 3-2 2-3-3-3 3-2-2 3-3z"];

/** A number with a fixed count of decimals, or a dash where it is not known. */
function figure(value, decimals) {
  return Number.isFinite(value) ? value.toFixed(decimals).replace("-", "\u2212") : "\u2013";
}

/** Decimals that show three digits of a length in mm, but no more than a hundredth of a micrometre. */
function millimetres(value) {
  if (!Number.isFinite(value)) return "\u2013";
  const size = Math.abs(value);
  return figure(value, size >= 100 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : size >= 0.1 ? 3 : size >= 0.001 ? 4 : 5);
}

function element(name, attributes = {}, ...children) {
  const node = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    node.setAttribute(key, value);
  }
  node.append(...children);
  return node;
}

/** The mark of a group as an inline picture. */
function mark(kind) {
  const drawing = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  drawing.setAttribute("viewBox", "0 0 14 14");
  drawing.setAttribute("class", "mark");
  drawing.setAttribute("aria-hidden", "true");
  const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
  path.setAttribute("d", MARK_PATHS[kind]);
  path.setAttribute("fill", kind === OUTLIERS ? "#000" : "#9fb0c2");
  path.setAttribute("stroke", "#1a1f29");
  path.setAttribute("stroke-width", kind === OUTLIERS ? "0.5" : "1.6");
  drawing.append(path);
  return drawing;
}

/** Name of a row as short as it can be: with its point where there are several, with its group where names repeat. */
function rowName(table, row) {
  if (table.several === undefined) {
    table.several = new Set(table.targets).size > 1;
    table.repeated = new Set(table.labels.map((label, k) => `${label}\n${table.targets[k]}`)).size < table.n;
  }
  return table.labels[row] + (table.several ? ` ${table.targets[row]}` : "")
    + (table.repeated ? ` (${["fit", "val", "meas", "out"][table.group[row] % 4]})` : "");
}

function poseName(table, row) {
  return `Pose ${rowName(table, row)}`;
}

class Panel {
  constructor(scene, table) {
    this.scene = scene;
    this.table = table;
    this.lengths = {};
    document.getElementById("title").textContent = scene.title;
    this.summary();
    this.notes();
  }

  notes() {
    const { notes } = this.scene;
    document.getElementById("notes-block").hidden = notes.length === 0;
    document.getElementById("notes").append(...notes.map((note) => element("li", {}, note)));
  }

  summary() {
    const place = document.getElementById("summary");
    const { summary, noise, verdict } = this.scene;
    if (verdict) {
      place.append(element("p", { class: `verdict ${verdict.grade}` }, element("strong", {}, verdict.grade),
        verdict.reasons.length ? ` ${verdict.reasons[0]}` : " nothing was found against this fit"));
      if (verdict.reasons.length > 1) {
        place.append(element("details", {}, element("summary", {}, `${verdict.reasons.length - 1} more to know`),
          element("ul", {}, ...verdict.reasons.slice(1).map((reason) => element("li", {}, reason)))));
      }
    }
    const both = summary.filter((row) => row.before && row.after);
    if (both.length) {
      const judged = both.find((row) => row.group === "validation") || both[0];
      place.append(element("p", { class: "figures" }, element("strong", { id: "mean-before" }, millimetres(judged.before.mean)),
        "\u2192", element("strong", { id: "mean-after" }, millimetres(judged.after.mean)), element("strong", {}, "mm")),
        element("p", {}, `mean position error before and after calibration, ${judged.count} ${judged.group} poses`));
    }
    if (summary.length) {
      const head = [element("tr", {}, element("th", {}, ""), ...["before", "after"].map((text) => element("th", { scope: "colgroup", colspan: "2" }, text))),
        element("tr", {}, ...["Error [mm]", "mean", "max", "mean", "max"].map((text) => element("th", { scope: "col" }, text)))];
      const body = summary.map((row) => element("tr", {}, element("th", { scope: "row" }, `${row.group} (${row.count})`),
        ...[row.before, row.after].flatMap((part) => [part ? part.mean : NaN, part ? part.max : NaN]).map((value) => element("td", {}, millimetres(value)))));
      place.append(element("table", {}, element("thead", {}, ...head), element("tbody", {}, ...body)));
    }
    if (Number.isFinite(noise)) {
      place.append(element("p", {}, `Measurement noise: ${millimetres(1e3 * noise)} mm per axis (1\u03c3)`));
    }
    if (!summary.length) {
      place.append(element("p", {}, this.table.n ? "Predicted positions; nothing was measured here."
        : "No poses: the robot in its home configuration."));
    }
  }

  /** Length of a row's error [m]; all are worked out once. */
  error(state, row) {
    if (!this.lengths[state]) {
      const values = this.table[state];
      this.lengths[state] = Float64Array.from({ length: this.table.n },
        (_, k) => Math.hypot(values[3 * k], values[3 * k + 1], values[3 * k + 2]));
    }
    return this.lengths[state][row];
  }

  /** The rows with the largest errors, largest first. */
  largest(rows, state, count) {
    const found = [];
    for (const row of rows) {
      const error = this.error(state, row);
      if (!Number.isFinite(error) || (found.length === count && error <= this.error(state, found[count - 1]))) continue;
      const place = found.findIndex((other) => error > this.error(state, other));
      found.splice(place < 0 ? found.length : place, 0, row);
      found.length = Math.min(found.length, count);
    }
    return found;
  }

  pose(row, state) {
    const { table, scene } = this;
    const head = document.getElementById("pose-head");
    head.replaceChildren(element("span", { class: "name" }, `Pose ${table.labels[row]}${table.several ? `, ${table.targets[row]}` : ""}`),
      element("span", { class: "tag" }, KINDS[table.group[row] % 4]));
    if (table.group[row] >= OUTLIERS) {
      head.append(element("span", { class: "tag outlier" }, "outlier"));
    }
    const at = (values, scale = 1e3) => [0, 1, 2].map((i) => scale * values[3 * row + i]);
    const sum = (a, b) => a.map((value, i) => value + b[i]);
    const measured = at(table.measured);
    const base = measured.every(Number.isFinite) ? measured : [NaN, NaN, NaN];
    const lines = [["measured", measured, 3, false]];
    for (const name of scene.states.length ? scene.states : []) {
      lines.push([`pred. ${name}`, sum(base, at(table[name])), 3, false]);
    }
    if (!scene.states.length) lines.push(["predicted", at(table.place), 3, false]);
    for (const name of scene.states) {
      const error = at(table[name]);
      lines.push([`error ${name}`, [...error, Math.hypot(...error)], 4, name === state]);
    }
    if (scene.states.includes("after")) {
      const ratio = at(table.after, 1 / table.sigma[row]);
      lines.push(["residual / \u03c3", [...ratio, Math.hypot(...ratio)], 2, false]);
      lines.push(["pred. \u00b1 1\u03c3", at(table.spread), 4, false]);
    }
    document.querySelector("#position tbody").replaceChildren(...lines.map(([name, values, decimals, now]) =>
      element("tr", now ? { class: "now" } : {}, element("th", { scope: "row" }, name),
        ...[0, 1, 2, 3].map((i) => element("td", {}, i < values.length ? figure(values[i], decimals) : "")))));
    const joints = scene.joints.map(({ name, unit, per_si }, i) => element("tr", {}, element("th", { scope: "row" }, name),
      element("td", {}, `${figure(per_si * table.joints[row * scene.joints.length + i], 2)} ${unit}`)));
    document.querySelector("#joints tbody").replaceChildren(...joints);
  }

  /** Buttons for the poses with the largest errors among the visible rows. */
  worst(rows, state, go) {
    const place = document.getElementById("worst");
    const sorted = this.largest(rows, state, 5);
    place.hidden = sorted.length === 0;
    document.getElementById("worst-title").textContent = `Largest errors ${state} calibration [mm]`;
    place.querySelector("ol").replaceChildren(...sorted.map((row) => {
      const button = element("button", { type: "button", "aria-label": `Go to ${poseName(this.table, row)}, error ${millimetres(1e3 * this.error(state, row))} mm` },
        `${rowName(this.table, row)}: ${millimetres(1e3 * this.error(state, row))}`);
      button.addEventListener("click", () => go(row));
      return element("li", {}, button);
    }));
  }

  /** Say in the legend how many times the vectors are enlarged; nothing when they are hidden. */
  vectorNote(factor, visible) {
    document.getElementById("legend-vectors").textContent = visible ? `Error vectors enlarged \u00d7${factor}` : "";
  }

  legend(state, low, high, logarithmic, groups) {
    document.getElementById("legend-title").textContent = `Error ${state} calibration [mm]`;
    const canvas = document.getElementById("legend-bar");
    const context = canvas.getContext("2d");
    const image = context.createImageData(256, 1);
    image.data.set(this.scene.colourBytes);
    context.putImageData(image, 0, 0);
    const ticks = ticksBetween(1e3 * low, 1e3 * high, logarithmic).map(([value, part]) => {
      const tick = element("span", {}, String(Number(value.toPrecision(3))));
      tick.style.left = `${100 * part}%`;
      return tick;
    });
    document.getElementById("legend-ticks").replaceChildren(...ticks);
    const beyond = Array.from({ length: this.table.n }, (_, row) => this.error(state, row)).some((error) => error > high);
    document.getElementById("legend-beyond").textContent = beyond ? "Larger errors have the last colour" : "";
    document.getElementById("legend-marks").replaceChildren(...groups.filter((kind) => kind !== 3).map((kind) => element("span", {}, mark(kind),
      kind === OUTLIERS ? "outlier" : KINDS[kind])));
  }
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

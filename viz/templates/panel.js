// The panel: numbers of the chosen pose, legend and summary. It only reads the scene and writes text.
"use strict";

class Panel {
  /** @param table a PoseTable */
  constructor(scene, table) {
    this.scene = scene;
    this.table = table;
    document.getElementById("title").textContent = scene.title;
    this.remarks();
    this.summary();
    this.notes();
  }

  notes() {
    const { notes } = this.scene;
    document.getElementById("notes-block").hidden = notes.length === 0;
    document.getElementById("notes").append(...notes.map((note) => element("li", {}, note)));
  }

  /** What the measurement files say about themselves: the first line at once, the others on request. */
  remarks() {
    const { lines, more, simulated } = this.scene.remarks;
    const place = document.getElementById("remarks");
    place.hidden = lines.length === 0;
    if (!lines.length) return;
    if (simulated) place.classList.add("simulated");
    const rest = [...lines.slice(1), ...(more ? [`and ${more} more lines`] : [])];
    const first = [element("strong", {}, "From the file: "), lines[0]];
    place.append(rest.length ? element("details", {}, element("summary", {}, ...first),
      ...rest.map((line) => element("p", {}, line))) : element("p", {}, ...first));
  }

  summary() {
    const place = document.getElementById("summary");
    const { summary, verdict } = this.scene;
    if (verdict) place.append(...this.verdict(verdict));
    const both = summary.filter((row) => row.before && row.after);
    if (both.length) {
      const judged = both.find((row) => row.group === "validation") || both[0];
      place.append(...this.headline(judged.before.rms, judged.after.rms, "mm",
        `position error (RMS) before and after calibration, ${judged.poses} ${judged.group} poses`));
    }
    if (summary.length) {
      place.append(this.errorTable("Error [mm]", summary.map((row) => [`${row.group} (${row.poses})`,
        ...[row.before, row.after].flatMap((part) => [part ? part.rms : NaN, part ? part.max : NaN])])));
    }
    place.append(...this.others(!both.length), ...this.certainty());
    if (!summary.length && !this.scene.others.length) {
      place.append(element("p", {}, this.table.n ? "Predicted positions; no points were measured here."
        : "No poses: the robot in its home configuration."));
    }
  }

  /** An error before and after calibration in large letters, and what it is. */
  headline(before, after, unit, text) {
    return [element("p", { class: "numbers" }, element("strong", { id: "error-before" }, millimetres(before)), "\u2192",
      element("strong", { id: "error-after" }, millimetres(after)), element("strong", {}, unit)), element("p", {}, text)];
  }

  /** @param rows name, and RMS and largest error before and after */
  errorTable(title, rows) {
    const head = element("tr", {}, ...[title, "RMS", "max", "RMS", "max"].map((text) => element("th", { scope: "col" }, text)));
    const above = element("tr", {}, element("th", {}, ""), ...["before", "after"].map((text) => element("th", { scope: "colgroup", colspan: "2" }, text)));
    const body = rows.map(([name, ...errors]) => tableRow(name, errors.map(millimetres)));
    return element("table", {}, element("thead", {}, above, head), element("tbody", {}, ...body));
  }

  /** Errors of what is read beside positions, in their own units; the first as a headline where there are no positions. */
  others(first) {
    const parts = [];
    const named = { identification: "identification", validation: "validation", cross_validation: "left out in turn" };
    for (const { of, part, unit, sets, space } of this.scene.others) {
      if (first && !parts.length) {
        const judged = sets.find(({ group }) => group === "validation") || sets.find(({ group }) => group === "cross_validation") || sets[0];
        parts.push(...this.headline(judged.before[0], judged.after[0], unit,
          `${part} error of ${of} (RMS) before and after calibration, ${named[judged.group] || judged.group} poses`
          + (space ? `; at the measured points, that is ${millimetres(space[0])} \u2192 ${millimetres(space[1])} mm` : "")));
      }
      parts.push(this.errorTable(`${of}: ${part} [${unit}]`, sets.map(({ group, before, after }) => [named[group] || group, ...before, ...after])));
    }
    if (first && this.scene.others.length && this.scene.others[0].several) { // a headline, its table, and those of each
      parts.push(element("details", {}, element("summary", {}, "Each instrument"), ...parts.splice(3)));
    }
    return parts;
  }

  verdict({ grade, reasons, next }) {
    const reasonText = (reason) => (reason.grade ? `${reason.grade}: ${reason.text}` : reason.text);
    const parts = [element("p", { class: `verdict ${grade}` }, element("strong", {}, grade),
      reasons.length ? ` ${reasons[0].text}` : " this fit can be used at poses like those measured")];
    if (reasons.length > 1) {
      parts.push(element("details", {}, element("summary", {}, `${reasons.length - 1} more`),
        element("ul", {}, ...reasons.slice(1).map((reason) => element("li", {}, reasonText(reason))))));
    }
    if (next) parts.push(element("p", { id: "next-step" }, element("strong", {}, "Next: "), ...this.withOptions(next)));
    return parts;
  }

  /** A sentence with a command, whose options are not broken after their hyphens. */
  withOptions(sentence) {
    return sentence.split(/( )/).map((word) => (word.startsWith("-") ? element("span", { class: "option" }, word) : word));
  }

  /** How sure the numbers are: of one reading, of a pose's mean of several, and of what the robot predicts. */
  certainty() {
    const { noise, means, readings, predicted } = this.scene.certainty;
    const lines = [];
    if (noise !== null) {
      const [least, most] = readings;
      const range = (low, high, text) => (text(low) === text(high) ? text(low) : `${text(low)} to ${text(high)}`);
      lines.push(element("p", { id: "noise" }, `Noise of one reading: ${millimetres(noise)} mm per axis (1\u03c3)`
        + (most > 1 ? `; of a pose, the mean of ${range(least, most, String)} readings: ${range(...means, millimetres)} mm` : "")));
    }
    if (predicted) {
      lines.push(element("p", { id: "predicted" }, `Predicted positions are known to ${millimetres(predicted[0])} mm on average over all poses, ${millimetres(predicted[1])} mm`
        + " at worst (1\u03c3)"));
    }
    return lines;
  }

  /** Numbers of a row of the table. */
  pose(row, state) {
    const { table, scene } = this;
    const head = document.getElementById("pose-head");
    const readings = table.readings[row];
    const at = (values, scale = 1e3) => [0, 1, 2].map((i) => scale * values[3 * row + i]);
    const measured = at(table.measured);
    const seen = measured.every(Number.isFinite);
    head.replaceChildren(element("span", { class: "name" }, `Pose ${table.labels[row]}${table.several[table.part[row]] ? `, ${table.targets[row]}` : ""}`),
      element("span", { class: "tag" }, table.groups[table.kind(row)].name),
      ...(readings > 1 && seen ? [element("span", { class: "tag" }, `mean of ${readings} readings`)] : []),
      ...(table.isOutlier(row) ? [element("span", { class: "tag outlier" }, "outlier")] : []));
    const sum = (a, b) => a.map((value, i) => value + b[i]);
    const isPoint = row < table.n_points;
    if (!isPoint) this.reading(row, state);
    document.getElementById("position").hidden = !isPoint;
    document.getElementById("reading").hidden = isPoint;
    const lines = [["measured", measured, 3, false]];
    if (seen) lines.push(...scene.states.map((name) => [`pred. ${name}`, sum(measured, at(table[name])), 3, false]));
    if (!seen || !scene.states.length) lines.push(["predicted", at(table.place), 3, false]);
    for (const name of scene.states) {
      const error = at(table[name]);
      lines.push([`error ${name}`, [...error, Math.hypot(...error)], 4, name === state]);
    }
    if (scene.states.includes("after")) {
      const sigma = table.sigma[row];
      const ratio = at(table.after, sigma > 0 ? 1 / sigma : NaN);
      lines.push(["residual / \u03c3", [...ratio, Math.hypot(...ratio)], 2, false]);
      lines.push(["pred. \u00b1 1\u03c3", at(table.spread), 4, false]);
    }
    this.positions(lines);
    const note = scene.states.includes("after") && table.sigma[row] > 0
      ? `\u03c3 = ${millimetres(1e3 * table.sigma[row])} mm, of ${readings > 1 ? `a mean of ${readings} readings` : "one reading"}` : "";
    document.getElementById("sigma-note").textContent = note;
    this.joints(scene.joints.map((_, i) => table.joints[row * scene.joints.length + i]));
  }

  /** Error of a reading that is no position: its components, and how far the point is off in space. */
  reading(row, state) {
    const { table, scene } = this;
    const { name, unit, axes, turns } = table.parts[table.part[row]];
    const several = axes.length > 1;
    const inSpace = !turns && unit !== "mm";
    const heads = [...(several ? axes : []), several ? "size" : name, ...(inSpace ? ["in space [mm]"] : [])];
    const node = document.getElementById("reading");
    node.querySelector("caption").textContent = `${name[0].toUpperCase()}${name.slice(1)} [${unit}]`;
    node.querySelector("thead").replaceChildren(element("tr", {}, element("th", { scope: "col" }, ""),
      ...heads.map((text) => element("th", { scope: "col" }, text))));
    node.querySelector("tbody").replaceChildren(...scene.states.map((one) => {
      const parts = several ? [...table.components(one, row), table.error(one, row)] : table.components(one, row);
      const numbers = inSpace ? [...parts, table.arrow(one, row)] : parts;
      return tableRow(`error ${one}`, numbers.map((value) => fixed(value, 4)), one === state ? { class: "now" } : {});
    }));
  }

  /** Without poses there are numbers only of what moves. */
  home() {
    document.getElementById("pose-block").hidden = true;
  }

  /** Numbers of joint values that a live program or a hand gives; nothing was measured there, so there are no errors. */
  live({ joints, targets, predicted, byHand }) {
    document.getElementById("pose-block").hidden = false;
    document.getElementById("position").hidden = false;
    document.getElementById("reading").hidden = true;
    document.getElementById("pose-head").replaceChildren(
      element("span", { class: "name" }, byHand ? "Moved by hand" : "Live configuration"),
      element("span", { class: "tag" }, byHand ? "not measured" : "shown by the program, not measured"));
    const lines = Object.entries(predicted).filter(([, positions]) => positions).flatMap(([state, positions]) =>
      positions.map((position, k) => [`${this.scene.ghost ? `pred. ${state}` : "predicted"}${targets.length > 1 ? `, ${targets[k]}` : ""}`,
        position.map((value) => 1e3 * value), 3, false]));
    this.positions(lines);
    document.getElementById("sigma-note").textContent = "";
    this.joints(joints);
  }

  /** @param lines name, numbers, decimals, and whether it is the state that is shown */
  positions(lines) {
    document.querySelector("#position tbody").replaceChildren(...lines.map(([name, values, decimals, now]) =>
      tableRow(name, [0, 1, 2, 3].map((i) => (i < values.length ? fixed(values[i], decimals) : "")), now ? { class: "now" } : {})));
  }

  /** Joint values [m or rad] in as many columns as the longest name leaves room for. */
  joints(values) {
    const rows = this.scene.joints.map(({ name, unit, per_si }, i) => [name, `${fixed(per_si * values[i], 2)} ${unit}`]);
    const letters = Math.max(0, ...rows.map(([name]) => Math.min(name.length, 24) + 13)); // 13: -1234.56 deg
    const body = document.querySelector("#joints tbody");
    body.style.setProperty("--letters", letters);
    body.replaceChildren(...rows.map(([name, value]) => tableRow(name, [value])));
  }

  /** Buttons for the poses with the largest errors among the visible rows; the focus stays at its place in the list. */
  worst(rows, state, go) {
    const place = document.getElementById("worst");
    const sorted = this.table.largest(rows, state, 5);
    place.hidden = sorted.length === 0;
    const { unit } = this.table.parts[rows.length ? this.table.part[rows[0]] : 0];
    document.getElementById("worst-title").textContent = `Largest errors ${state} calibration [${unit}]`;
    const list = place.querySelector("ol");
    const focused = [...list.querySelectorAll("button")].indexOf(document.activeElement);
    list.replaceChildren(...sorted.map((row) => {
      const [name, error] = [this.table.name(row), millimetres(this.table.error(state, row))];
      const button = element("button", { type: "button", "aria-label": `Go to pose ${name}, error ${error} ${unit}` }, `${name}: ${error}`);
      button.addEventListener("click", () => go(row));
      return element("li", {}, button);
    }));
    const buttons = list.querySelectorAll("button");
    if (focused >= 0 && buttons.length) buttons[Math.min(focused, buttons.length - 1)].focus();
  }

  /** Say in the legend how many times what is shown is enlarged; nothing about what is hidden. */
  enlarged({ turns }, vectors, ghost) {
    const what = turns ? "Axes of turns, 1 mrad as long as 1 mm" : "Error vectors enlarged";
    document.getElementById("legend-vectors").textContent = vectors ? `${what} \u00d7${vectors}` : "";
    const text = ghost === 1 ? "Ghost: nominal robot, true to scale (\u00d71)"
      : `Ghost: nominal robot, displacement \u00d7${ghost}`;
    document.getElementById("legend-ghost").hidden = !ghost;
    document.getElementById("legend-ghost-text").textContent = ghost ? text : "";
  }

  legend(part, state, low, high, logarithmic, groups, outliers) {
    const { name, unit, position } = this.table.parts[part];
    const title = position ? "Error" : `${name[0].toUpperCase()}${name.slice(1)} error`;
    document.getElementById("legend-title").textContent = `${title} ${state} calibration [${unit}]`;
    drawBar(document.getElementById("legend-bar"), this.scene.colourBytes);
    document.getElementById("legend-ticks").replaceChildren(...tickMarks(low, high, logarithmic));
    const beyond = Array.from({ length: this.table.n }, (_, row) => this.table.part[row] === part && this.table.error(state, row) > high).some(Boolean);
    document.getElementById("legend-beyond").textContent = beyond ? `Last colour: ${Number(high.toPrecision(3))} ${unit} and more` : "";
    const marks = [...groups.map(({ name, mark }) => [mark, name]), ...(outliers ? [["cross", "outlier"]] : []), ["ring", "chosen pose"]];
    document.getElementById("legend-marks").replaceChildren(...marks.map(([mark, name]) => element("span", {}, markPicture(mark), name)));
  }
}

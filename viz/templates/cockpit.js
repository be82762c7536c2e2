// The measuring cockpit: what the program that watches a measurement tells, above the picture, never over it.
"use strict";

const CURVE = { width: 300, height: 150, left: 44, right: 10, top: 8, bottom: 34 };

class Cockpit {
  constructor() {
    this.root = document.getElementById("cockpit");
  }

  /** @param told what `calib.Progress.to_dict` has, its words, and the states before (`viz.live`) */
  show(told) {
    const set = (id, text) => { document.getElementById(id).textContent = text; };
    this.root.hidden = false;
    document.body.classList.add("measuring");
    const state = told.stop ? "met" : told.out_of_reach || !told.next ? "beyond" : "go";
    this.root.dataset.state = state;
    set("signal", state === "go" ? "GO" : "STOP");
    set("signal-why", { met: `goal ${told.goal_mm} mm reached`, go: "measure the next pose",
      beyond: told.out_of_reach ? "more poses will not help" : "every candidate is measured" }[state]);
    const left = state !== "go" || told.poses_left === null ? "" : `about ${told.poses_left} more${this.time(told.seconds_left)}`;
    set("count", `${told.poses} ${told.poses === 1 ? "pose" : "poses"} measured${left ? `; ${left}` : ""}`);
    set("judged", told.words);
    this.next(told.stop ? null : told.next);
    this.curve(told);
  }

  time(seconds) {
    if (seconds === null) return "";
    return seconds < 90 ? `, ${Math.max(10, 10 * Math.round(seconds / 10))} s` : `, ${Math.round(seconds / 60)} min`;
  }

  next(next) {
    const node = document.getElementById("next-pose");
    node.hidden = !next;
    if (!next) return;
    node.replaceChildren(element("h2", {}, `Next: pose ${next.pose}`), element("table", {}, element("tbody", {},
      ...Object.entries(next.joints).map(([name, { value, unit }]) => tableRow(name, [`${fixed(value, 3)} ${unit}`])))));
  }

  /** Predicted and unseen error against poses, and the goal; logarithmic upwards. */
  curve({ history, goal_mm: goal, poses_left: left95 }) {
    const { width, height, left, right, top, bottom } = CURVE;
    const known = history.flatMap(([, ...errors]) => errors).filter((value) => value > 0);
    const drawing = document.getElementById("curve");
    drawing.closest("figure").hidden = known.length === 0;
    if (!known.length) return;
    const [low, high] = [Math.min(goal, ...known) / 1.3, Math.max(goal, ...known) * 1.3];
    const counts = history.map(([n]) => n);
    const now = counts[counts.length - 1];
    const [first, last] = [Math.min(...counts), Math.max(now + (left95 || 0), ...counts, Math.min(...counts) + 1)];
    const x = (n) => left + (n - first) / (last - first) * (width - left - right);
    const y = (value) => top + Math.log(high / value) / Math.log(high / low) * (height - top - bottom);
    const line = (column, name) => {
      const points = history.filter((row) => row[column] > 0).map((row) => `${x(row[0]).toFixed(1)},${y(row[column]).toFixed(1)}`);
      return points.length > 1 ? [svgElement("polyline", { class: name, points: points.join(" ") })]
        : points.map((point) => svgElement("circle", { class: name, cx: point.split(",")[0], cy: point.split(",")[1], r: 3 }));
    };
    const band = (lower, name) => { // the 95 % interval
      const rows = history.filter((row) => row[lower] > 0 && row[lower + 1] > 0);
      const edge = (column, along) => along.map((row) => `${x(row[0]).toFixed(1)},${y(row[column]).toFixed(1)}`);
      return rows.length < 2 ? [] : [svgElement("polygon", { class: name, points: [...edge(lower, rows), ...edge(lower + 1, [...rows].reverse())].join(" ") })];
    };
    const reached = history[history.length - 1][1];
    const way = left95 && reached > 0 ? [svgElement("line", { class: "way", x1: x(now), y1: y(reached), x2: x(now + left95), y2: y(goal) })] : [];
    const ticks = ticksBetween(low, high, true).filter((_, k, all) => all.length <= 5 || k % 2 === 0);
    drawing.replaceChildren(
      ...ticks.flatMap(([value]) => [svgElement("line", { class: "grid", x1: left, x2: width - right, y1: y(value), y2: y(value) }),
        svgElement("text", { x: left - 5, y: y(value) + 4, "text-anchor": "end" }, String(Number(value.toPrecision(2))))]),
      svgElement("line", { class: "goal", x1: left, x2: width - right, y1: y(goal), y2: y(goal) }),
      ...band(3, "predicted"), ...band(5, "unseen"), ...way, ...line(1, "predicted"), ...line(2, "unseen"),
      ...[first, last].map((n, k) => svgElement("text", { x: x(n), y: height - bottom + 15, "text-anchor": k ? "end" : "start" }, String(n))),
      svgElement("text", { x: (left + width - right) / 2, y: height - bottom + 15, "text-anchor": "middle" }, "poses"));
  }
}

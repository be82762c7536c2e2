// The table of poses: typed arrays and what to call each row. Groups come from the scene (viz/poses.py), by number.
"use strict";

/** Typed array from base64. */
function decode(text, Type) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Type(bytes.buffer);
}

class PoseTable {
  /** @param scene table (arrays as base64), groups: name, short name and mark of each group */
  constructor(scene) {
    const { table, groups } = scene;
    Object.assign(this, table);
    for (const name of ["measured", "place", "before", "after", "sigma", "spread", "joints"]) {
      this[name] = decode(table[name], Float64Array);
    }
    this.group = decode(table.group, Uint8Array); // number of the group; with `nGroups` more: the same, an outlier
    this.groups = groups;
    this.nGroups = groups.length;
    this.several = new Set(this.targets).size > 1;
    this.repeated = new Set(this.labels.map((label, k) => `${label}\n${this.targets[k]}`)).size < this.n;
    this.lengths = {};
  }

  kind(row) {
    return this.group[row] % this.nGroups;
  }

  isOutlier(row) {
    return this.group[row] >= this.nGroups;
  }

  /** Name of a row as short as can be: with its point where there are several, with its group where names repeat. */
  name(row) {
    return this.labels[row] + (this.several ? ` ${this.targets[row]}` : "")
      + (this.repeated ? ` (${this.groups[this.kind(row)].short})` : "");
  }

  /** Length of a row's error [m]; all are worked out once. */
  error(state, row) {
    if (!this.lengths[state]) {
      const values = this[state];
      this.lengths[state] = Float64Array.from({ length: this.n },
        (_, k) => Math.hypot(values[3 * k], values[3 * k + 1], values[3 * k + 2]));
    }
    return this.lengths[state][row];
  }

  /** The rows with the largest errors, largest first. */
  largest(rows, state, count) {
    const worst = [];
    for (const row of rows) {
      const error = this.error(state, row);
      if (!Number.isFinite(error) || (worst.length === count && error <= this.error(state, worst[count - 1]))) continue;
      const place = worst.findIndex((other) => error > this.error(state, other));
      worst.splice(place < 0 ? worst.length : place, 0, row);
      worst.length = Math.min(worst.length, count);
    }
    return worst;
  }
}

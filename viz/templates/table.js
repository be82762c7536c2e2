// The table of poses: typed arrays and what to call each row. Groups come from the scene (viz/poses.py), by number.
"use strict";

/** Typed array from base64. */
function decode(text, Type) {
  const letters = atob(text);
  const bytes = new Uint8Array(letters.length);
  for (let k = 0; k < bytes.length; k += 1) bytes[k] = letters.charCodeAt(k); // ten times as fast as Uint8Array.from
  return new Type(bytes.buffer);
}

class PoseTable {
  /** @param scene table (arrays as base64), groups: name, short name and mark of each group */
  constructor(scene) {
    const { table, groups, parts } = scene;
    Object.assign(this, table, { parts });
    for (const name of ["measured", "place", "before", "after", "sigma", "spread", "joints", "size_before", "size_after",
      "residual_before", "residual_after"]) {
      this[name] = decode(table[name], Float64Array);
    }
    this.part = decode(table.part, Uint8Array); // number of the part of readings that a row is of
    this.pose = decode(table.pose, Uint32Array); // number of the robots' pose
    this.group = decode(table.group, Uint8Array); // number of the group; with `nGroups` more: the same, an outlier
    this.groups = groups;
    this.nGroups = groups.length;
    this.several = parts.map((_, part) => new Set(this.targets.filter((__, k) => this.part[k] === part)).size > 1);
    this.repeated = new Set(this.labels.map((label, k) => `${label}\n${this.targets[k]}\n${this.part[k]}`)).size < this.n;
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
    return this.labels[row] + (this.several[this.part[row]] ? ` ${this.targets[row]}` : "")
      + (this.repeated ? ` (${this.groups[this.kind(row)].short})` : "");
  }

  /** Size of a row's error in the unit of its part; all are worked out once. */
  error(state, row) {
    if (!this.lengths[state]) {
      this.lengths[state] = Float64Array.from({ length: this.n },
        (_, k) => (k < this.n_points ? this.arrow(state, k) : this[`size_${state}`][k - this.n_points]));
    }
    return this.lengths[state][row];
  }

  /** Length of a row's arrow [mm, or mrad of turns]. */
  arrow(state, row) {
    return 1e3 * Math.hypot(...this[state].subarray(3 * row, 3 * row + 3));
  }

  /** Components of the error of a row that is no point, in the unit of its part. */
  components(state, row) {
    const first = 3 * (row - this.n_points);
    return Array.from(this[`residual_${state}`].subarray(first, first + this.parts[this.part[row]].axes.length));
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

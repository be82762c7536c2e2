// Groups of rows: which are shown, their boxes in the panel, and which the legend names.
"use strict";

class Groups {
  /**
   * @param table a PoseTable
   * @param changed is called when the reader shows or hides a group
   */
  constructor(table, changed) {
    this.table = table;
    this.changed = changed;
    this.shown = { groups: table.groups.map(() => true), outliers: true };
  }

  /** Boxes for the groups that a part of the readings has. */
  offer(part) {
    const { groups, nGroups } = this.table;
    const place = document.getElementById("groups");
    const group = this.table.group.filter((_, row) => this.table.part[row] === part);
    const count = (matches) => group.filter(matches).length;
    place.replaceChildren();
    const add = (name, mark, n, shown, choose) => {
      const box = element("input", { type: "checkbox", id: `show-${name.replace(" ", "-")}` });
      box.checked = shown;
      box.disabled = n === 0;
      box.addEventListener("change", () => { choose(box.checked); this.changed(); });
      const text = name[0].toUpperCase() + name.slice(1);
      place.append(element("label", { class: "check" }, box, markPicture(mark), element("span", {}, `${text} (${n})`)));
    };
    groups.forEach(({ name, mark }, kind) => {
      const n = count((code) => code % nGroups === kind);
      if (n || name === "identification" || name === "validation") {
        add(name, mark, n, this.shown.groups[kind], (checked) => { this.shown.groups[kind] = checked; });
      }
    });
    this.nOutliers = count((code) => code >= nGroups);
    add("outliers", "cross", this.nOutliers, this.shown.outliers, (checked) => { this.shown.outliers = checked; });
    place.hidden = this.table.n === 0;
    // of what was left out the legend has the cross alone: all of it are outliers
    this.inLegend = groups.filter((_, kind) => count((code) => code === kind) > 0);
  }

  /** Whether rows of each code are shown: a group, and whether it is an outlier. */
  visible() {
    const { nGroups } = this.table;
    return Array.from({ length: 2 * nGroups }, (_, code) =>
      this.shown.groups[code % nGroups] && (code < nGroups || this.shown.outliers));
  }

  /** The rows of a part of the readings that are shown. */
  rows(part) {
    const { table } = this;
    const visible = this.visible();
    return Array.from({ length: table.n }, (_, row) => row).filter((row) => visible[table.group[row]] && table.part[row] === part);
  }
}

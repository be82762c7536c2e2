// Plots that respond: each mark knows the row of the page's table that it is of, so that hover, and a selection in a plot,
// in space or in a table, mean the same poses everywhere. Bokeh draws them, panel by panel, so that the page answers in
// between: first what is in or near the window, then the others.
"use strict";

const TOUCH = window.matchMedia("(pointer: coarse)").matches;
const PAPER = 688; // width of what is printed on A4 [px]
const FRAME = 16; // [ms]

/** An element with attributes and children. */
function element(name, attributes, ...children) {
  const node = document.createElement(name);
  Object.entries(attributes).forEach(([key, value]) => node.setAttribute(key, value));
  node.append(...children);
  return node;
}

/** Text in lines of at most `most` letters; names are broken after _ and before the part that follows a point. */
function inLines(text, most) {
  return (text || "").split("\n").flatMap((line) => line.split(/(?<=[ _])|(?<=\.)(?=[a-z])/i).reduce((lines, piece) => {
    const longer = (lines.at(-1) || "") + piece;
    return lines.length && longer.trimEnd().length <= most ? [...lines.slice(0, -1), longer] : [...lines, piece];
  }, [])).map((line) => line.trimEnd()).join("\n");
}

/** Let the browser answer, and after a time [ms] show what was drawn. */
function breath(time) {
  return new Promise((next) => { setTimeout(next, time); });
}

/** A colour such as #0072B2, mixed with white so that it is seen on a dark page. */
function lighter(colour) {
  const part = (k) => Number(`0x${colour.slice(k, k + 2)}`);
  return `#${[1, 3, 5].map((k) => Math.round(0.65 * part(k) + 0.35 * 255).toString(16)).join("")}`;
}

/** Distance of an axis' ticks whose numbers do not touch.
 * @param room length of the axis [px]
 * @param digit width of a digit [px]
 */
function tickDistance(start, end, room, digit) {
  const whole = String(Math.floor(Math.max(Math.abs(start), Math.abs(end)))).length + (start < 0 ? 1 : 0);
  for (let power = Math.floor(Math.log10((end - start) / 8)); ; power += 1) {
    for (const mantissa of room < 150 ? [1, 1.5, 2, 3, 4, 5] : [1, 2, 5]) {
      const distance = mantissa * 10 ** power;
      const decimals = Math.max(0, (mantissa % 1 ? 1 : 0) - power);
      const wide = digit * (whole + (decimals ? decimals + 1 : 0) + (room < 150 ? 1 : 2)); // paper may have less room
      if (room * distance / (end - start) > Math.max(wide, room / 8)) return distance;
    }
  }
}

/** Ticks of a logarithmic axis whose numbers do not touch: powers of ten first.
 * @param room length of the axis [px]
 * @param half half of the length along the axis that a number takes [px]
 */
function logarithmicTicks(start, end, room, half) {
  const at = (value) => room * Math.log(value / start) / Math.log(end / start);
  const chosen = [];
  for (const mantissa of [1, 5, 2, 3, 7]) {
    for (let power = Math.floor(Math.log10(start)); power <= Math.log10(end); power += 1) {
      const value = Number(`${mantissa}e${power}`);
      const free = chosen.every((other) => Math.abs(at(other) - at(value)) > half(other) + half(value));
      if (value >= start && value <= end && free) chosen.push(value);
    }
  }
  return chosen.sort((a, b) => a - b);
}

/** The poses that are selected, and who shows them. */
class Selection {
  /** @param rows of the page's table: texts, poses, marks */
  constructor(rows) {
    this.rows = rows;
    this.poses = new Set();
    this.followers = [];
    document.getElementById("unselect").addEventListener("click", () => this.choose([]));
    document.querySelectorAll("main [data-row]").forEach((node) => this.offer(node));
  }

  /** @param rows whose poses are selected; none: all are as they were */
  choose(rows) {
    const poses = new Set(rows.map((row) => this.rows.poses[row]));
    this.poses = poses;
    this.followers.forEach((follow) => follow());
    this.tell();
  }

  /** Let an element with a row select its pose, and show when it is selected. */
  offer(node) {
    const row = Number(node.dataset.row);
    const choose = () => this.choose([row]);
    node.addEventListener("click", choose);
    node.addEventListener("keydown", (event) => { if (event.key === "Enter") choose(); });
    this.followers.push(() => node.classList.toggle("chosen", this.has(row)));
  }

  has(row) {
    return row !== null && this.poses.has(this.rows.poses[row]);
  }

  /** What is selected, in words. */
  tell() {
    const box = document.getElementById("selected");
    box.hidden = this.poses.size === 0;
    const rows = this.rows.texts.filter((_, row) => this.has(row));
    const text = rows.length === 1 ? rows[0] : `${this.poses.size} ${this.poses.size === 1 ? "pose" : "poses"} selected: ${rows.slice(0, 3).join("; ")}${rows.length > 3 ? " …" : ""}`;
    box.querySelector("span").textContent = text;
  }
}

/** One chart: its panels in a grid that has room for them, and the numbers behind it. */
class Chart {
  constructor(node, { panels, wide }, selection) {
    this.node = node;
    this.panels = panels;
    this.selection = selection;
    this.sources = [];
    this.grid = this.node.querySelector(".panels");
    this.small = wide < 250;
    this.grid.style.setProperty("--wide", `${wide}px`);
    this.node.style.setProperty("--tall", `${panels[0].height}px`);
    this.grid.replaceChildren(...panels.map(({ height }) => element("div", { class: "panel", style: `min-height: ${height}px` })));
    this.node.querySelector("details").addEventListener("toggle", () => this.table(), { once: true });
    selection.followers.push(() => this.follow());
  }

  /** Draw all panels, once. */
  async draw() {
    if (this.drawn) return;
    this.drawn = true;
    delete this.node.dataset.drawn;
    const style = getComputedStyle(document.documentElement);
    this.ink = style.getPropertyValue("--ink").trim();
    this.line = style.getPropertyValue("--line").trim();
    this.paper = style.getPropertyValue("--paper").trim();
    this.dark = window.matchMedia("(prefers-color-scheme: dark)").matches;
    this.views = [];
    for (const [k, panel] of this.panels.entries()) {
      const place = this.grid.children[k];
      const figure = this.figure(panel, place.clientWidth);
      place.replaceChildren();
      place.addEventListener(TOUCH ? "pointerdown" : "pointermove", () => { figure.toolbar.buttons = "auto"; }, { once: true });
      const view = await Bokeh.Plotting.show(figure, place);
      const { primary } = view.canvas_view;
      primary.clear = () => primary.ctx.clearRect(-1, -1, primary.bbox.width + 2, primary.bbox.height + 2); // Bokeh leaves half a pixel
      this.views.push(view);
      await breath(0);
    }
    if (this.selection.poses.size) this.follow();
    this.node.dataset.drawn = "true";
  }

  /** Keep pictures of the panels for paper, as wide as it is: a browser that prints lays no plot out anew. */
  keep() {
    if (!this.node.dataset.drawn) return;
    const style = getComputedStyle(document.documentElement);
    const laidOut = (width) => {
      this.node.style.width = width;
      this.views.forEach((view) => view.invalidate_layout());
    };
    const onPaper = Object.fromEntries(["ink", "line", "paper"].map((name) => [this[name], style.getPropertyValue(`--printed-${name}`).trim()]));
    const colours = { ...onPaper, ...Object.fromEntries(this.panels.flatMap(({ layers }) => layers).filter(({ colour }) => colour).map(({ colour }) => [lighter(colour), colour])) };
    if (this.dark) this.recolour(colours);
    laidOut(`${PAPER}px`);
    this.views.forEach((view, k) => {
      const picture = element("img", { alt: "", src: view.export("png").canvas.toDataURL() });
      this.grid.children[k].querySelectorAll("img").forEach((old) => old.remove());
      this.grid.children[k].append(picture);
    });
    if (this.dark) this.recolour(Object.fromEntries(Object.entries(colours).map((pair) => pair.reverse())));
    laidOut("");
  }

  /** Draw in other colours. @param colours the new ones by the old ones */
  recolour(colours) {
    const other = (colour) => colours[colour] || colour;
    for (const model of this.views.flatMap((view) => [...view.model.references()])) {
      for (const name of Object.keys(model.properties).filter((each) => each.endsWith("color"))) {
        const value = model[name];
        if (typeof value === "string") model[name] = other(value);
        else if (value && typeof value.value === "string") model[name] = other(value.value);
      }
      if (model.data && model.data.colour) model.data = { ...model.data, colour: model.data.colour.map(other) };
    }
    this.views.forEach((view) => view.renderer_views.forEach((each) => each.set_visuals && each.set_visuals())); // now, not later
  }

  /** Draw again, in the colours of the page as it is now. */
  again() {
    if (!this.drawn) return undefined;
    this.views.forEach((view) => view.clear && view.clear());
    [this.drawn, this.sources] = [false, []];
    return this.draw();
  }

  /** @param room width that the panel has [px] */
  figure({ x, y, layers, title, height, equal, bare }, room) {
    const letter = this.small ? 6.2 : 7.2; // width of one in the name of an axis [px]
    const names = y.names.map((name) => inLines(name, room / 15).split("\n"));
    const frame = room - Math.max(this.small ? 90 : 70, ...names.flat().map((line) => 40 + letter * line.length)); // about
    const range = ({ log, ends, names }, turned) => (names.length ? new Bokeh.Range1d({ start: turned ? names.length - 0.5 : -0.5, end: turned ? -0.5 : names.length - 0.5 })
      : ends ? new Bokeh.Range1d({ start: ends[0], end: ends[1] }) : new Bokeh.DataRange1d({ range_padding: 0.12 }));
    const figure = new Bokeh.Plotting.Figure({
      height: height + 13 * names.length * Math.max(0, ...names.map((name) => name.length - 1)), sizing_mode: "stretch_width", title: inLines(title, room / 7.8) || null, x_axis_label: inLines(x.label, frame / letter) || null, y_axis_label: inLines(y.label, (height - 60) / letter) || null,
      x_axis_type: x.log ? "log" : "linear", y_axis_type: y.log ? "log" : "linear",
      x_range: range(x, false), y_range: range(y, true), match_aspect: equal, tools: "pan,wheel_zoom,box_zoom,box_select,tap,reset,save",
      toolbar_location: "above", background_fill_color: null, border_fill_color: null, outline_line_color: null,
      lod_threshold: null,
    });
    this.look(figure, x, y, height, room);
    const digit = this.small ? 6 : 7;
    if (!x.names.length) this.spaceTicks(figure, x.log, Math.max(40, frame), 0, digit, (value) => digit * (String(value).length + 1) / 2);
    if (y.log) this.spaceTicks(figure, true, height - 90, 1, digit, () => 9);
    if (bare) [...figure.xaxes, ...figure.yaxes, ...figure.center.filter((part) => part.type === "Grid")].forEach((part) => { part.visible = false; });
    const own = []; // what a selection in this panel changes
    const hovered = layers.flatMap((layer) => this.layer(figure, layer, own, y.beyond && y.ends));
    figure.add_tools(new Bokeh.HoverTool({ renderers: hovered, tooltips: "<div style='max-width: 260px; white-space: normal'>@text</div>", point_policy: "snap_to_data" }));
    figure.toolbar.logo = null;
    figure.toolbar.autohide = !TOUCH;
    figure.toolbar.buttons = []; // a tenth of the time of drawing: made when a pointer first comes
    const select = figure.toolbar.tools.find((tool) => tool.type === "BoxSelectTool");
    figure.toolbar.active_drag = TOUCH ? null : select;
    if (figure.legend.items.length > 0) {
      figure.legend.items.forEach((item) => { item.index = Math.max(0, (item.renderers[0].data_source.data.mark || []).indexOf("circle")); }); // no mark of validation
      const wide = layers.flatMap(({ label }) => (label ? [7 * (4 + label.length)] : [])).sort((a, b) => b - a); // of entries [px]
      const sum = (count) => wide.slice(0, count).reduce((a, b) => a + b, 0);
      Object.assign(figure.legend, { location: "top_left", orientation: "horizontal", ncols: sum(wide.length) < frame ? "auto" : sum(2) < frame ? 2 : 1, label_text_color: this.ink, label_text_font_size: "12px",
        background_fill_alpha: 0, border_line_color: null, click_policy: "hide", padding: 0, margin: 0 });
      figure.add_layout(figure.legend, "above");
    } else figure.legend.visible = false;
    return figure;
  }

  /** Space the ticks of an axis, also after zoom, so that its numbers do not touch.
   * @param dimension 0: the lower axis; 1: the left one
   * @param half as of `logarithmicTicks`
   */
  spaceTicks(figure, log, room, dimension, digit, half) {
    const ticker = log ? new Bokeh.FixedTicker({ ticks: [], minor_ticks: [] }) : new Bokeh.SingleIntervalTicker({ interval: 1, num_minor_ticks: 0 });
    const range = [figure.x_range, figure.y_range][dimension];
    const space = () => {
      const [low, high] = [range.start, range.end];
      if (!(high > low)) return;
      if (log) ticker.ticks = logarithmicTicks(low, high, room, half);
      else ticker.interval = tickDistance(low, high, room, digit);
    };
    [range.properties.start, range.properties.end].forEach((property) => property.change.connect(space));
    space();
    [figure.xaxes, figure.yaxes][dimension].forEach((axis) => { axis.ticker = ticker; });
    figure.center.filter((part) => part.type === "Grid" && part.dimension === dimension).forEach((grid) => { grid.ticker = ticker; });
  }

  look(figure, x, y, height, room) {
    for (const [axes, { names, log }] of [[figure.xaxes, x], [figure.yaxes, y]]) {
      for (const axis of axes) {
        Object.assign(axis, { axis_label_text_color: this.ink, major_label_text_color: this.ink, axis_line_color: this.ink, major_tick_line_color: this.ink,
          minor_tick_line_color: null, axis_label_text_font_size: this.small ? "11px" : "13px", axis_label_text_font_style: "normal", major_label_text_font_size: this.small ? "10px" : "12px" });
        if (names.length) {
          axis.ticker = new Bokeh.FixedTicker({ ticks: names.map((_, k) => k), minor_ticks: [] });
          axis.major_label_overrides = new Map(names.map((name, k) => [k, inLines(name, room / 15)]));
        } else if (!log && height < 220) axis.ticker.desired_num_ticks = 3;
        axis.formatter = log ? new Bokeh.PrintfTickFormatter({ format: "%.3g" }) : new Bokeh.BasicTickFormatter({ power_limit_low: -5, power_limit_high: 7 });
      }
    }
    for (const grid of figure.center.filter((part) => part.type === "Grid")) Object.assign(grid, { grid_line_color: this.line, grid_line_alpha: 0.7 });
    if (figure.title) Object.assign(figure.title, { text_color: this.ink, text_font_size: "13px" });
  }

  /** Draw a layer; what hover finds of it.
   * @param ends between which marks are kept, or null
   */
  layer(figure, { kind, label, colour, ...columns }, own, ends) {
    const paint = !colour ? this.ink : this.dark ? lighter(colour) : colour;
    const known = label && (columns.x || columns.y || []).length ? { legend_label: label } : {};
    if (kind === "line") {
      const overPoints = figure.renderers.some(({ glyph }) => glyph.type === "Scatter");
      if (overPoints) figure.line(columns.x, columns.y, { line_color: this.paper, line_width: 5 });
      figure.line(columns.x, columns.y, { line_color: paint, line_width: overPoints ? 2.5 : 1.5, ...known });
      return [];
    }
    if (kind === "band") {
      figure.quad({ left: columns.left, right: columns.right, bottom: [figure.y_range.start], top: [figure.y_range.end], fill_color: paint, fill_alpha: 0.18, line_color: null,
        ...(label ? { legend_label: label } : {}) });
      return [];
    }
    const { rows } = this.selection;
    const n = (columns.x || columns.y).length;
    const all = (value) => new Array(n).fill(value);
    const data = { ...columns, rows: columns.rows || all(null), colour: columns.colours || all(paint),
      text: columns.rows ? columns.rows.map((row) => rows.texts[row]) : columns.texts || all(""),
      mark: columns.rows ? columns.rows.map((row) => rows.marks[row]) : all("circle") };
    delete data.thick;
    if (ends) data.y = data.y.map((value) => (value === null ? null : 0.96 * Math.min(ends[1], Math.max(ends[0], value / 0.96))));
    const source = new Bokeh.ColumnDataSource({ data });
    const field = (name) => ({ field: name });
    let drawn;
    if (kind === "points") {
      drawn = figure.scatter({ x: field("x"), y: field("y"), source, marker: field("mark"), size: n > 300 ? (this.small ? 3 : 4) : this.small ? 5 : 7, fill_color: field("colour"), fill_alpha: 0.75,
        line_color: columns.colours ? this.ink : field("colour"), line_width: columns.colours ? 0.4 : 1.2, nonselection_alpha: 0.12, ...known });
    } else if (kind === "bars") {
      drawn = figure.hbar({ y: field("y"), source, left: field("left"), right: field("right"), height: columns.thick[0], fill_color: field("colour"), fill_alpha: 0.9,
        line_color: null, ...known });
    } else {
      drawn = figure.rect({ x: field("x"), y: field("y"), width: field("width"), height: field("height"), source, fill_color: field("colour"), fill_alpha: 0.45, line_color: null });
    }
    if (columns.rows) {
      this.sources.push(source);
      own.push(source);
      source.selected.properties.indices.change.connect(() => this.take(own));
    }
    return columns.rows || columns.texts ? [drawn] : [];
  }

  /** A reader selected marks of a panel, whose sources change one after another. */
  take(own) {
    if (this.following) return;
    clearTimeout(this.waiting);
    this.waiting = setTimeout(() => this.selection.choose(own.flatMap(({ selected, data }) => selected.indices.map((k) => data.rows[k]))));
  }

  /** Show what is selected. */
  follow() {
    this.following = true;
    for (const source of this.sources) {
      const chosen = source.data.rows.flatMap((row, k) => (this.selection.has(row) ? [k] : []));
      source.selected.indices = chosen;
    }
    this.following = false;
  }

  /** The numbers behind the chart, a line for each mark; a click on a line selects its pose. */
  table() {
    const { texts } = this.selection.rows;
    const lines = this.panels.flatMap(({ x, y, layers, title }) => layers.filter(({ kind }) => kind !== "line" && kind !== "band").flatMap((layer) => {
      const at = (values, k) => (values === undefined || values[k] === null ? "" : String(values[k]));
      return (layer.x || layer.y).map((_, k) => {
        const row = layer.rows ? layer.rows[k] : null;
        const what = row === null ? (layer.texts || [])[k] || (y.names || [])[k] || "" : texts[row];
        const line = element("tr", {}, element("th", { scope: "row" }, what), ...[title || layer.label, at(layer.x || layer.right, k), layer.x ? at(layer.y, k) : ""].map((text) => element("td", {}, text)));
        if (row !== null) {
          line.dataset.row = row;
          line.tabIndex = 0;
          line.classList.toggle("chosen", this.selection.has(row));
          this.selection.offer(line);
        }
        return line;
      });
    }));
    const { x, y } = this.panels[0];
    this.node.querySelector("details div").replaceChildren(element("table", { class: "numbers" },
      element("thead", {}, element("tr", {}, ...["what", "", x.label, y.label].map((text) => element("th", { scope: "col" }, text)))), element("tbody", {}, ...lines)));
  }
}

/** Text that the page holds compressed. */
async function unpack(id) {
  const text = atob(document.getElementById(id).textContent);
  const bytes = new Uint8Array(text.length);
  for (let k = 0; k < bytes.length; k += 1) bytes[k] = text.charCodeAt(k); // ten times as fast as Uint8Array.from
  return new Response(new Response(bytes).body.pipeThrough(new DecompressionStream("gzip"))).text();
}

/** Run a script that the page holds compressed; the page's policy knows it by its digest. */
async function run(id) {
  document.body.append(element("script", {}, await unpack(id)));
}

/** The robot in space: the same page as the viewer, in a frame; and its picture, where the page is printed. */
class Space {
  constructor(selection) {
    this.frame = document.getElementById("space");
    this.selection = selection;
  }

  async open() {
    this.frame.srcdoc = await unpack("viewer-page");
    await new Promise((done) => { this.frame.addEventListener("load", done, { once: true }); });
    const page = this.frame.contentDocument;
    this.viewer = this.frame.contentWindow.calibrationViewer;
    page.addEventListener("picked", (event) => this.selection.choose([event.detail]));
    this.selection.followers.push(() => this.viewer.select(this.viewer.table.n ? Array.from({ length: this.viewer.table.n }, (_, row) => this.selection.has(row)) : [],
      this.selection.poses.size > 0));
    for (const button of document.querySelectorAll("[data-press]")) {
      const pressed = page.getElementById(button.dataset.press);
      button.hidden = !pressed || !!pressed.closest("[hidden]");
      const show = () => button.setAttribute("aria-pressed", String(pressed.checked));
      button.addEventListener("click", () => { pressed.click(); document.querySelectorAll("[data-press]").forEach((other) => other.dispatchEvent(new Event("shown"))); });
      button.addEventListener("shown", show);
      show();
    }
    document.getElementById("turn").addEventListener("click", (event) => { event.target.hidden = true; });
    document.getElementById("turn").hidden = !TOUCH;
  }

  /** Show what is drawn; some browsers have dropped it, so that it is drawn again. */
  async show() {
    this.frame.contentDocument.body.dataset.shown = "true";
    await breath(10 * FRAME);
    if (this.viewer.stage) this.viewer.stage.redraw();
  }

  /** Keep the picture for paper. */
  keep() {
    const url = this.viewer.still();
    if (url) document.getElementById("still").src = url;
  }
}

async function startReport() {
  await new Promise((painted) => { requestAnimationFrame(() => setTimeout(painted, 0)); });
  const { rows, charts } = JSON.parse(await unpack("charts"));
  const selection = new Selection(rows);
  const drawn = [...document.querySelectorAll(".chart")].map((node) => new Chart(node, charts[node.id], selection)); // from above
  window.calibrationReport = { selection, charts: drawn };
  const space = document.getElementById("space") && new Space(selection);
  if (space) await space.open();
  if (drawn.length) {
    await run("bokeh");
    await run("bokeh-api");
    Bokeh.set_log_level("error");
  }
  try {
    for (const chart of drawn.filter(({ grid }) => grid.getBoundingClientRect().top < window.innerHeight)) await chart.draw();
  } finally {
    if (space) space.show();
  }
  let last = Promise.resolve();
  const inTurn = (work) => { last = last.finally(work).finally(() => breath(FRAME)); return last; };
  const near = new IntersectionObserver((entries) => entries.filter(({ isIntersecting }) => isIntersecting)
    .forEach(({ target }) => inTurn(() => drawn.find(({ node }) => node === target).draw())), { rootMargin: "300px" });
  drawn.forEach(({ node }) => near.observe(node));
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => drawn.forEach((chart) => inTurn(() => chart.again())));
  const beside = [...document.querySelectorAll(".halves > .chart")]; // the robot, which paper has as a picture elsewhere
  window.addEventListener("beforeprint", () => {
    [...(space ? [space] : []), ...drawn].forEach((part) => part.keep());
    document.getElementById("on-paper")?.append(...beside);
  });
  window.addEventListener("afterprint", () => beside.forEach((node) => document.querySelector(".halves").append(node)));
  document.body.dataset.ready = "true";
  const rest = async () => {
    for (const chart of drawn) await inTurn(() => chart.draw());
    if (space) space.keep();
  };
  window.calibrationReport.all = rest;
  (window.requestIdleCallback || setTimeout)(rest);
}

window.addEventListener("DOMContentLoaded", startReport);

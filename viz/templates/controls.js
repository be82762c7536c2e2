// The controls: state of the page, what each control shows, and what a live program shows.
"use strict";

class Controls {
  constructor(scene) {
    this.take(scene);
    this.groups = new Groups(this.table, () => this.filter());
    this.stage = this.makeStage();
    this.morph = new Morph((part) => this.setMark("state", part));
    this.player = new Player(() => this.showNext());
    this.theme = new Theme((theme) => {
      if (this.stage) this.stage.paint(theme);
    });
    wireControls(this);
    this.begin();
    this.mapPanel = new MapPanel(this.stage && this.stage.map, scene.colourBytes, () => this.stage.redraw());
    if (this.stage) this.stage.begin();
  }

  /** Make a scene the page's own, with its last state and its first row. */
  take(scene) {
    this.scene = scene;
    this.table = new PoseTable(scene);
    scene.colourBytes = decode(scene.colours, Uint8ClampedArray);
    for (const robot of [scene.solid, scene.ghost].filter(Boolean)) robot.values = decode(robot.values, Float32Array);
    this.panel = new Panel(scene, this.table);
    this.state = scene.states.includes("after") ? "after" : "before";
    this.part = 0; // of readings, whose errors are shown
    this.row = 0;
    this.live = null; // what a live program shows instead of a pose
    this.vectorFactors = scene.parts.map(({ vector_factors }) => ({ ...vector_factors }));
    this.ghostFactor = scene.ghost_factor;
  }

  /** Show the scene that was taken. Sliders of the motors need no 3D view: the numbers work without it. */
  begin() {
    const { scene } = this;
    const tree = this.stage ? this.stage.tree : new Tree(scene.bodies);
    this.drive = new DrivePanel(scene, tree, { solid: scene.solid, ghost: scene.ghost }, (state) => this.showLive(state));
    this.arrange();
    this.filter();
    this.applyState();
    this.applyVisibility();
    this.go(0);
  }

  /** The 3D stage; null where the browser has no WebGL: the numbers work without it. */
  makeStage() {
    const { scene, table } = this;
    try {
      const stage = new Stage(document.getElementById("pane"), scene);
      if (table.n) stage.addMarks(this.makeMarks(stage.THREE));
      if (scene.map) stage.addMap(new WorkspaceMap(stage.THREE, scene.map, colourTexture(stage.THREE, Uint8Array.from(scene.colourBytes)),
                                                   stage.viewer.renderer.getPixelRatio()));
      return stage;
    } catch (problem) {
      const text = document.createElement("p");
      text.className = "fatal";
      text.textContent = `3D cannot be shown in this browser (${problem.message}). Switch WebGL on, or use another browser.`;
      document.getElementById("stage").append(text);
      return null;
    }
  }

  makeMarks(THREE) {
    const { scene, table } = this;
    return new Marks(THREE, table, Uint8Array.from(scene.colourBytes), scene.point_radius, scene.point_pixels);
  }

  /** Show another scene of the same robot in place of the present one; the camera stays where a hand has put it. */
  renew(scene) {
    this.player.pause();
    for (const id of ["summary", "notes", "remarks", "drive-sliders", "part"]) document.getElementById(id).replaceChildren();
    this.take(scene);
    this.groups.table = this.table; // what the reader has hidden stays hidden
    if (this.stage) this.stage.renew(scene, this.table.n ? this.makeMarks(this.stage.THREE) : null);
    this.theme.use(document.getElementById("dark").checked);
    this.begin();
    if (this.stage && this.stage.direction) this.resetCamera();
  }

  /** Which controls the scene has use for, and how they stand at first. */
  arrange() {
    for (const state of ["before", "after"]) {
      document.getElementById(`state-${state}`).disabled = !this.scene.states.includes(state);
    }
    document.getElementById("scale-label").hidden = this.scene.states.length < 2;
    document.getElementById("state-switch").hidden = this.scene.states.length === 0;
    document.getElementById("state-block").hidden = this.scene.states.length === 0 && !this.scene.ghost;
    document.getElementById("legend").hidden = this.scene.states.length === 0 && !this.scene.ghost && !this.scene.map;
    document.getElementById("legend-errors").hidden = this.scene.states.length === 0;
    document.getElementById("pose-block").hidden = this.table.n === 0;
    document.getElementById("ghost-row").hidden = !this.scene.ghost;
    document.getElementById("decorations-row").hidden = this.scene.n_decorations === 0;
    document.getElementById("robot-name").textContent = this.scene.ghost ? "Calibrated robot" : "Robot";
    this.wirePart();
    this.groups.offer(this.part);
    document.getElementById("ghost-factor").show(this.ghostFactor);
    document.getElementById("point-size-row").hidden = this.table.n === 0;
    document.getElementById("show-vectors").closest(".row").hidden = this.scene.states.length === 0;
  }

  /** Of which part of the readings errors are shown, where there are several. */
  wirePart() {
    const chosen = document.getElementById("part");
    const { parts } = this.scene;
    chosen.append(...parts.map(({ name, unit }, number) => element("option", { value: number }, `${name} [${unit}]`)));
    chosen.closest(".row").hidden = parts.length < 2;
  }

  showPart(part) {
    this.part = part;
    document.getElementById("part").value = part;
    this.setMark("chosenPart", part);
    this.groups.offer(this.part);
    this.filter();
    this.applyState();
    this.noteFactors();
  }

  /** Give the marks' shaders a value. */
  setMark(name, value) {
    if (!this.stage || !this.stage.marks) return;
    this.stage.marks.uniforms[name].value = value;
    this.stage.redraw();
  }

  /** Which rows are visible; the slider and the arrow keys run over these only. */
  filter() {
    this.rows = this.groups.rows(this.part);
    this.setMark("visible", this.groups.visible().map(Number));
    const slider = document.getElementById("pose");
    slider.max = Math.max(0, this.rows.length - 1);
    for (const id of ["pose", "previous", "next", "play"]) {
      document.getElementById(id).disabled = this.rows.length === 0;
    }
    if (!this.rows.length) this.player.pause();
    this.panel.worst(this.rows, this.state, (row) => this.go(row));
    if (this.live) return; // what a program shows stays
    if (this.rows.length) {
      this.go(this.nearest());
    } else if (this.stage && this.stage.marks) {
      this.stage.marks.choose(-1);
    }
  }

  /** The visible row at or after the present one; of another part, one of the same pose of the robot. */
  nearest() {
    const { part, pose } = this.table;
    const same = part[this.row] === this.part ? undefined : this.rows.find((row) => pose[row] === pose[this.row]);
    return same ?? this.rows.find((row) => row >= this.row) ?? this.rows[this.rows.length - 1];
  }

  /** The next visible row; from what a program shows, back to the pose before it. */
  step(by) {
    if (!this.rows.length) return;
    const after = this.rows.findIndex((row) => row >= this.row);
    const here = after < 0 ? this.rows.length : after;
    const place = this.live ? here : here + by;
    this.go(this.rows[Math.min(Math.max(place, 0), this.rows.length - 1)]);
  }

  /** The reader, or a live program, goes to a row: what plays stops there. */
  go(row) {
    this.player.pause();
    if (this.table.n && this.table.part[row] !== this.part) this.showPart(this.table.part[row]);
    this.showRow(row);
  }

  /** The next pose while they play; after the last one comes the first. */
  showNext() {
    this.showRow(this.rows[(this.rows.indexOf(this.row) + 1) % this.rows.length]);
  }

  showRow(row) {
    this.row = row;
    this.live = null;
    if (this.stage) {
      this.stage.live = null;
      this.stage.showPose(this.poseOf(row));
    }
    const count = this.scene.joints.length;
    this.drive.begin(this.table.n ? Array.from(this.table.joints.subarray(row * count, (row + 1) * count)) : this.scene.drive.home, this.poseOf(row));
    if (!this.table.n) {
      this.panel.home();
      return;
    }
    if (this.stage) this.stage.marks.choose(row);
    const slider = document.getElementById("pose");
    slider.value = Math.max(0, this.rows.indexOf(row));
    slider.setAttribute("aria-valuetext", `Pose ${this.table.name(row)}, ${Number(slider.value) + 1} of ${this.rows.length}`);
    this.showNumbers();
  }

  /** Number of the robots' pose of a row. */
  poseOf(row) {
    return this.table.n ? this.table.pose[row] : 0;
  }

  /** Numbers of what is shown. */
  showNumbers() {
    if (this.live) this.panel.live(this.live);
    else if (this.table.n) this.panel.pose(this.row, this.state);
  }

  /** Whether both states share colours (then logarithmic, to hold both) and enlargement. */
  sameScale() {
    return document.getElementById("same-scale").checked && this.scene.states.length > 1;
  }

  /** Whose enlargement is used: with the same scale, that of the larger errors. */
  vectorState() {
    return this.sameScale() ? "before" : this.state;
  }

  /** Show the other state. On one scale the errors become the others; on two, lengths between would be on neither. */
  become(state) {
    this.state = state;
    this.applyState(this.sameScale());
  }

  /** @param gradually whether errors become those of the state before the eyes of the reader */
  applyState(gradually = false) {
    if (!this.scene.states.length) return;
    document.getElementById(`state-${this.state}`).checked = true;
    const same = this.sameScale();
    document.getElementById("vector-factor").show(this.vectorFactors[this.part][this.vectorState()]);
    const { range } = this.scene.parts[this.part];
    const [low, high] = (same ? range.both : range[this.state]) || range.both || [0, 1];
    Object.entries({ low, high, logarithmic: Number(same) }).forEach(([name, value]) => this.setMark(name, value));
    this.morph.to(this.state === "before" ? 0 : 1, gradually);
    this.panel.legend(this.part, this.state, low, high, same, this.groups.inLegend, this.groups.nOutliers > 0);
    this.panel.worst(this.rows, this.state, (row) => this.go(row));
    this.showNumbers();
  }

  applyVisibility() {
    if (!this.stage) return;
    const on = (id) => document.getElementById(id).checked;
    const { viewer, marks, ghostRoot } = this.stage;
    viewer.scene_tree.find(["meshcat", "robot"]).object.visible = on("show-robot");
    viewer.scene_tree.find(["meshcat", "decorations"]).object.visible = on("show-decorations");
    if (marks) marks.vectors.visible = on("show-vectors");
    if (ghostRoot) ghostRoot.visible = on("show-ghost");
    this.stage.showFrames(on("show-frames"));
    this.noteFactors();
  }

  noteFactors() {
    const on = (id) => document.getElementById(id).checked;
    const vectors = this.scene.states.length && on("show-vectors") ? this.vectorFactors[this.part][this.vectorState()] : null;
    this.panel.enlarged(this.scene.parts[this.part], vectors, this.scene.ghost && on("show-ghost") ? this.ghostFactor : null);
  }

  savePicture() {
    if (!this.stage) return;
    const { title } = this.scene;
    const pose = this.live ? "live" : this.table.n ? this.table.name(this.row) : "home";
    const parts = [title, ...(this.scene.states.length ? [this.state] : []), pose];
    savePicture(this.stage, `${title}, ${this.table.n && !this.live ? `pose ${pose}` : pose}`, parts.join("-"));
  }

  /** Mark rows that are selected beside the others, or none of them. @param chosen of each row whether it is selected */
  select(chosen, any) {
    if (!this.stage || !this.stage.marks) return;
    this.stage.marks.select(chosen, any);
    const first = chosen.indexOf(true);
    if (first >= 0 && !chosen[this.row]) this.go(first);
    this.stage.redraw();
  }

  /** The picture as an address, on the light ground of paper; nothing where there is no 3D view. */
  still() {
    if (!this.stage) return "";
    const dark = this.theme.box.checked;
    const onPaper = (now, theme) => {
      document.body.classList.toggle("paper", now);
      this.theme.use(theme);
      this.stage.resize(); // the legend takes another part of it
    };
    onPaper(true, false);
    const picture = pictureOf(this.stage, "").toDataURL("image/png");
    onPaper(false, dark);
    return picture;
  }

  resetCamera() {
    if (this.stage) this.stage.look(this.scene.view.direction);
  }

  /** Front, side and top are seen from the points' side of the robot. */
  lookFrom(name) {
    if (!this.stage) return;
    const [x, y] = this.scene.view.direction;
    const ahead = Math.abs(x) > Math.abs(y) ? [Math.sign(x), 0] : [0, Math.sign(y)];
    const direction = { front: [...ahead, 0.02], side: [-ahead[1], ahead[0], 0.02], top: [0.001 * ahead[0], 0.001 * ahead[1], 1] };
    this.stage.look(direction[name]);
  }

  /** Show joint values of a live program, or of the sliders: `solid` and `ghost` in the order of the tree's columns. */
  showLive(live) {
    this.player.pause();
    this.live = live;
    if (this.stage) {
      this.stage.live = live;
      this.stage.showPose(this.stage.pose);
      if (this.stage.marks) this.stage.marks.choose(-1);
      if (!live.byHand && this.stage.direction) this.resetCamera();
    }
    for (const id of ["stepper", "player"]) {
      document.getElementById(id).hidden = this.table.n === 0;
    }
    document.getElementById("pose").setAttribute("aria-valuetext", "live configuration");
    this.showNumbers();
  }
}

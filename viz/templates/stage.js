// The 3D side of the page: meshcat's viewer with the replayed robot, its ghost, frames, points and camera.
"use strict";

const AXIS_COLOURS = ["#D55E00", "#009E73", "#0072B2"]; // x, y, z: told apart also by colour-blind readers

class Stage {
  constructor(pane, scene) {
    const { THREE } = MeshCat;
    this.THREE = THREE;
    this.scene = scene;
    this.pane = pane;
    this.viewer = new MeshCat.Viewer(pane, false); // `begin` lets it draw: not its own scene before
    this.viewer.gui.domElement.remove(); // meshcat's own controls: ours replace them, and would be tabbed through
    this.viewer.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
    this.viewer.set_3d_pane_size = () => {}; // `resize` does
    for (const name of ["Grid", "Axes", "Background"]) {
      this.viewer.set_property([name], "visible", false);
    }
    this.viewer.hide_background();
    this.light();
    for (const command of scene.commands) {
      this.viewer.handle_command_bytearray(decode(command, Uint8Array));
    }
    this.root = this.viewer.scene_tree.find(["meshcat"]).object;
    this.tree = new Tree(scene.bodies);
    this.groups = scene.body_paths.map((name) => this.viewer.scene_tree.find(["meshcat", "robot", name]).object);
    this.groups.forEach((group) => { group.matrixAutoUpdate = false; });
    this.size = this.sizeOf(scene);
    this.ghostGroups = scene.ghost ? this.makeGhost() : [];
    this.makeFrames();
    this.makeFloor();
    this.ghostFactor = 1;
    this.live = null; // joint values that a live program shows instead of a pose
    this.pose = 0;
    this.direction = scene.view.direction; // where `look` looks from, until the camera is moved by hand
    this.followRender();
    this.viewer.controls.addEventListener("start", () => { this.direction = null; }); // turned by hand: leave it so
  }

  /** Draw now that the legend has its size, and whenever something changes. */
  begin() {
    this.resize();
    this.viewer.animate();
    this.viewer.renderer.getContext().flush();
    new ResizeObserver(() => {
      if (this.pane.clientWidth !== this.width || this.pane.clientHeight !== this.height) this.resize();
    }).observe(this.pane);
  }

  sizeOf({ view: { low, high } }) {
    return Math.hypot(...[0, 1, 2].map((i) => high[i] - low[i]));
  }

  light() {
    const { THREE } = this;
    for (const name of ["SpotLight", "PointLightNegativeX", "PointLightPositiveX", "FillLight", "AmbientLight"]) {
      this.viewer.set_property(["Lights", name], "visible", false);
    }
    const lights = new THREE.Group();
    lights.add(new THREE.HemisphereLight(0xffffff, 0x8d98a5, 0.66));
    for (const [x, y, z, strength] of [[2, 1.5, 3, 0.42], [-2, 2, 1.5, 0.2]]) {
      const light = new THREE.DirectionalLight(0xffffff, strength);
      light.position.set(x, y, z);
      lights.add(light);
    }
    this.viewer.scene.add(lights);
  }

  makeGhost() {
    const { THREE } = this;
    const material = new THREE.MeshLambertMaterial({ transparent: true, opacity: 0.4, depthWrite: false,
      polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 }); // behind the solid robot where both coincide
    this.ghostMaterial = material;
    this.ghostRoot = new THREE.Group();
    this.root.add(this.ghostRoot);
    return this.groups.map((group) => {
      const copy = group.clone(true);
      copy.traverse((part) => {
        if (part.isMesh) {
          part.material = material;
          part.renderOrder = 2;
        }
      });
      this.ghostRoot.add(copy);
      return copy;
    });
  }

  makeFrames() {
    const { THREE } = this;
    const length = 0.045 * this.size;
    this.frames = this.scene.frames.map(({ body }) => {
      const triad = new THREE.Group();
      triad.matrixAutoUpdate = false;
      AXIS_COLOURS.forEach((colour, axis) => {
        const bar = new THREE.Mesh(new THREE.CylinderGeometry(0.022 * length, 0.022 * length, length, 8),
                                   new THREE.MeshBasicMaterial({ color: colour, depthTest: false, transparent: true }));
        bar.position.setComponent(axis, length / 2);
        if (axis === 0) bar.rotation.z = -Math.PI / 2;
        if (axis === 2) bar.rotation.x = Math.PI / 2;
        bar.renderOrder = 5;
        triad.add(bar);
      });
      triad.visible = false;
      this.root.add(triad);
      return { body, triad };
    });
    this.labels = new FrameLabels(document.getElementById("labels"), this.scene.frames.map(({ name }) => name),
                                  document.getElementById("legend-frames"));
    for (const [name, there] of [["pointermove", true], ["pointerdown", true], ["pointerleave", false]]) {
      this.pane.addEventListener(name, (event) => {
        const box = this.pane.getBoundingClientRect();
        this.labels.pointer = there ? [event.clientX - box.left, event.clientY - box.top] : null;
        this.placeLabels();
      });
    }
  }

  makeFloor() {
    const { THREE } = this;
    const { low, high } = this.scene.view;
    const grid = new THREE.GridHelper(2.4 * this.size, 24, 0x9aa7b5, 0xbcc6d1);
    grid.rotateX(Math.PI / 2);
    grid.position.set((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2] - 0.002 * this.size);
    grid.material.transparent = true;
    grid.material.opacity = 0.6;
    this.viewer.scene.add(grid);
    this.grid = grid;
  }

  /** Points and vectors; they exist only when there are poses. */
  addMarks(marks) {
    this.marks = marks;
    this.root.add(...marks.objects);
  }

  /** Another scene of the same robot: where it stands, and what was measured. */
  renew(scene, marks) {
    this.scene = scene;
    this.viewer.handle_command_bytearray(decode(scene.commands[0], Uint8Array)); // how the measurement frame stands
    this.size = this.sizeOf(scene);
    this.viewer.scene.remove(this.grid);
    this.makeFloor();
    if (scene.ghost && !this.ghostRoot) this.ghostGroups = this.makeGhost();
    this.live = null;
    if (this.marks) {
      this.root.remove(...this.marks.objects);
      for (const { geometry, material } of this.marks.objects) { geometry.dispose(); material.dispose(); }
    }
    this.marks = null;
    if (marks) this.addMarks(marks);
    this.resize();
  }

  /** What is known over the workspace. */
  addMap(map) {
    this.map = map;
    this.root.add(map.points, map.hull, map.ellipsoids);
  }

  resize() {
    [this.width, this.height] = [this.pane.clientWidth, this.pane.clientHeight];
    const [width, height] = [Math.max(this.width, 1), Math.max(this.height, 1)];
    this.viewer.camera.aspect = width / height;
    this.viewer.camera.updateProjectionMatrix();
    this.viewer.renderer.setSize(width, height);
    if (this.marks) {
      this.marks.uniforms.pixels.value = height * this.viewer.renderer.getPixelRatio();
      this.marks.uniforms.smallest.value = this.scene.point_pixels * Math.min(1, Math.max(0.6, width / 700)); // a small picture
    }
    if (this.direction) this.look(this.direction);
    this.redraw();
  }

  /** Draw ghost, points and surroundings in the colours of the page's theme, "light" or "dark". */
  paint(theme) {
    if (this.ghostMaterial) this.ghostMaterial.color.set(getComputedStyle(document.documentElement).getPropertyValue("--ghost").trim());
    if (this.marks) this.marks.uniforms.edge.value = EDGES[theme];
    this.viewer.scene_tree.find(["meshcat", "decorations"]).object.traverse(({ isMesh, material }) => {
      if (isMesh) material.emissive.copy(material.color).multiplyScalar(theme === "dark" ? 0.6 : 0); // wires are thin
    });
    this.redraw();
  }

  redraw() {
    this.viewer.set_dirty();
  }

  /** Move robot, ghost and frames to a pose, or to joint values given by a live program. */
  showPose(pose) {
    this.pose = pose;
    const { solid, ghost } = this.scene;
    const solidValues = this.live ? this.live.solid : valuesAt(solid, pose);
    this.solidMatrices = this.tree.matrices(solid, solidValues);
    this.place(this.groups, this.solidMatrices);
    if (ghost) {
      const ghostValues = this.live ? this.live.ghost : valuesAt(ghost, pose);
      this.ghostMatrices = this.tree.exaggerated(this.solidMatrices, this.tree.matrices(ghost, ghostValues), this.ghostFactor);
      this.place(this.ghostGroups, this.ghostMatrices);
    }
    const poses = this.tree.poses(solid, solidValues);
    for (const frame of this.frames) {
      frame.triad.matrix.set(...poses[frame.body], 0, 0, 0, 1);
    }
    this.redraw();
  }

  /** Places around the links of a robot that a live program moves, in the camera's world: poses that the outline may lack. */
  livePlaces() {
    if (!this.live) return [];
    this.root.updateMatrixWorld(true);
    const wide = 0.06 * this.size;
    return this.frames.map(({ body }) => this.solidMatrices[body]).flatMap((m) => [-wide, wide].map((by) => {
      const place = this.root.localToWorld(new this.THREE.Vector3(m[3], m[7], m[11]));
      place.y += by;
      return place;
    }));
  }

  place(groups, matrices) {
    groups.forEach((group, body) => {
      group.matrix.set(...matrices[body], 0, 0, 0, 1);
      group.matrixWorldNeedsUpdate = true;
    });
  }

  showFrames(visible) {
    for (const { triad } of this.frames) {
      triad.visible = visible;
    }
    this.labels.show(visible);
    this.redraw();
  }

  /** Keep the labels beside their frames whenever the picture is drawn. */
  followRender() {
    const render = this.viewer.render.bind(this.viewer);
    this.viewer.render = () => {
      render();
      this.placeLabels();
    };
  }

  placeLabels() {
    if (!this.labels.visible) return;
    const [width, height] = [this.pane.clientWidth, this.pane.clientHeight];
    const place = new this.THREE.Vector3();
    const places = this.frames.map(({ triad }) => {
      const [x, y, inFront] = this.onScreen(place.setFromMatrixPosition(triad.matrixWorld));
      return inFront && x >= 0 && y >= 0 && x <= width && y <= height ? [x, y] : null;
    });
    const legend = this.legendBox();
    this.labels.place(places, width, height, legend ? [legend] : []);
  }

  /** Where a point of the scene (changed by this) is on the pane: x and y [px], and whether it is before the camera. */
  onScreen(point) {
    point.project(this.viewer.camera);
    return [(point.x + 1) / 2 * this.pane.clientWidth, (1 - point.y) / 2 * this.pane.clientHeight, Math.abs(point.z) < 1];
  }

  /** Look from a direction (upright frame, z up), as near as the whole scene allows, also when the pane changes. */
  look(direction) {
    this.direction = direction;
    look(this, direction);
  }

  /**
   * Whether a link's origin, a visible point or the tip of its error vector lies in a part of the pane: left, top,
   * right, bottom [px].
   */
  anythingUnder([left, top, right, bottom]) {
    const place = new this.THREE.Vector3();
    const reach = 12;
    const under = ([x, y]) => x > left - reach && x < right + reach && y > top - reach && y < bottom + reach;
    this.root.updateMatrixWorld(true);
    const links = this.frames.map(({ body }) => this.onScreen(place.setFromMatrixPosition(this.groups[body].matrixWorld)));
    if (links.some(under)) return true;
    if (!this.marks) return false;
    const { marks } = this;
    const { table, uniforms, points, vectors } = marks;
    const error = uniforms.state.value < 0.5 ? table.before : table.after;
    for (let row = 0; row < table.n; row += 1) {
      if (!marks.shows(row)) continue;
      for (const factor of vectors.visible ? [0, uniforms.factor.value] : [0]) {
        place.set(...[0, 1, 2].map((i) => table.place[3 * row + i] + factor * (error[3 * row + i] || 0)));
        if (under(this.onScreen(points.localToWorld(place)))) return true;
      }
    }
    return false;
  }

  /** The part of the pane that the legend covers: [left, top, right, bottom] [px], or null. */
  legendBox() {
    const legend = document.getElementById("legend").getBoundingClientRect();
    const pane = this.pane.getBoundingClientRect();
    const covers = legend.width > 0 && legend.top < pane.bottom - 1 && legend.bottom > pane.top + 1;
    return covers ? [legend.left - pane.left, legend.top - pane.top, legend.right - pane.left, legend.bottom - pane.top] : null;
  }
}

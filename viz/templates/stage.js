// The 3D side of the page: meshcat's viewer with the replayed robot, its ghost, frames, points and camera.
"use strict";

const GHOST_COLOUR = 0x3a6ea5;
const AXIS_COLOURS = ["#D55E00", "#009E73", "#0072B2"]; // x, y, z: told apart also by colour-blind readers

/** Typed array from base64. */
function decode(text, Type) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Type(bytes.buffer);
}

class Stage {
  constructor(pane, labels, scene) {
    const { THREE } = MeshCat;
    this.THREE = THREE;
    this.scene = scene;
    this.labels = labels;
    this.pane = pane;
    this.viewer = new MeshCat.Viewer(pane);
    this.viewer.gui.domElement.remove(); // meshcat's own controls: ours replace them, and would be tabbed through
    this.viewer.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
    this.viewer.set_3d_pane_size = () => this.resize();
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
    this.solid = this.figure(scene.solid);
    this.ghost = scene.ghost ? this.figure(scene.ghost) : null;
    this.groups = scene.body_paths.map((name) => this.viewer.scene_tree.find(["meshcat", "robot", name]).object);
    this.groups.forEach((group) => { group.matrixAutoUpdate = false; });
    this.size = Math.hypot(...[0, 1, 2].map((i) => scene.view.high[i] - scene.view.low[i]));
    this.ghostGroups = this.ghost ? this.makeGhost() : [];
    this.makeFrames();
    this.makeFloor();
    this.ghostFactor = 1;
    this.live = null; // joint values that a live program shows instead of a pose
    this.pose = 0;
    this.followRender();
    this.resize();
    this.look(scene.view.direction);
    new ResizeObserver(() => this.resize()).observe(pane);
  }

  figure(data) {
    return { ...data, values: decode(data.values, Float32Array), width: data.width };
  }

  row(figure, pose) {
    return figure.values.subarray(pose * figure.width, (pose + 1) * figure.width);
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
    const material = new THREE.MeshLambertMaterial({ color: GHOST_COLOUR, transparent: true, opacity: 0.4, depthWrite: false,
      polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 }); // behind the solid robot where both coincide
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
    this.frames = this.scene.frames.map(({ body, name }) => {
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
      const label = document.createElement("span");
      label.textContent = name;
      label.hidden = true;
      this.labels.append(label);
      return { body, triad, label };
    });
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
  }

  /** Points and vectors; they exist only when there are poses. */
  addMarks(marks) {
    this.marks = marks;
    this.root.add(marks.points, marks.vectors, marks.ring);
    this.resize();
  }

  resize() {
    const width = Math.max(this.pane.clientWidth, 1);
    const height = Math.max(this.pane.clientHeight, 1);
    this.viewer.camera.aspect = width / height;
    this.viewer.camera.updateProjectionMatrix();
    this.viewer.renderer.setSize(width, height);
    if (this.marks) this.marks.uniforms.pixels.value = height * this.viewer.renderer.getPixelRatio();
    this.redraw();
  }

  redraw() {
    this.viewer.set_dirty();
  }

  /** Move robot, ghost and frames to a pose, or to joint values given by a live program. */
  showPose(pose) {
    this.pose = pose;
    const solidValues = this.live ? this.live.solid : this.row(this.solid, pose);
    this.solidMatrices = this.tree.matrices(this.solid, solidValues);
    this.place(this.groups, this.solidMatrices);
    if (this.ghost) {
      const ghostValues = this.live ? this.live.ghost : this.row(this.ghost, pose);
      this.ghostMatrices = this.tree.exaggerated(this.solidMatrices, this.tree.matrices(this.ghost, ghostValues),
                                                 this.ghostFactor);
      this.place(this.ghostGroups, this.ghostMatrices);
    }
    const poses = this.tree.poses(this.solid, solidValues);
    for (const frame of this.frames) {
      frame.triad.matrix.set(...poses[frame.body], 0, 0, 0, 1);
    }
    this.redraw();
  }

  place(groups, matrices) {
    groups.forEach((group, body) => {
      group.matrix.set(...matrices[body], 0, 0, 0, 1);
      group.matrixWorldNeedsUpdate = true;
    });
  }

  showFrames(visible) {
    for (const { triad, label } of this.frames) {
      triad.visible = visible;
      label.hidden = !visible;
    }
    this.redraw();
  }

  /** Keep the labels beside their frames whenever the picture is drawn. */
  followRender() {
    const render = this.viewer.render.bind(this.viewer);
    const place = new this.THREE.Vector3();
    this.viewer.render = () => {
      render();
      for (const { triad, label } of this.frames) {
        if (label.hidden) continue;
        place.setFromMatrixPosition(triad.matrixWorld).project(this.viewer.camera);
        const x = (place.x + 1) / 2 * this.pane.clientWidth + 6;
        const y = (1 - place.y) / 2 * this.pane.clientHeight - 6;
        label.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
      }
    };
  }

  /** Look from a direction (upright frame, z up), as near as the whole scene allows. */
  look(direction) {
    const { THREE } = this;
    const { camera, controls } = this.viewer;
    const turned = ([x, y, z]) => new THREE.Vector3(x, z, -y); // meshcat's camera lives where y is up
    const towards = turned(direction).normalize();
    const right = new THREE.Vector3().crossVectors(new THREE.Vector3(0, 1, 0), towards).normalize();
    const up = new THREE.Vector3().crossVectors(towards, right);
    const points = this.scene.view.outline.map(turned);
    camera.fov = 36;
    const vertical = Math.tan(camera.fov * Math.PI / 360) * 0.95;
    const horizontal = vertical * camera.aspect;
    const middle = (axis, scale) => { // halfway between the outermost lines of sight
      const sides = points.map((point) => [point.dot(axis) + scale * point.dot(towards), -point.dot(axis) + scale * point.dot(towards)]);
      return [Math.max(...sides.map(([side]) => side)), Math.max(...sides.map(([, side]) => side))];
    };
    const [rightmost, leftmost] = middle(right, horizontal);
    const [highest, lowest] = middle(up, vertical);
    // the camera at x right + y up + z towards sees a point if |offset| <= slope * (z - depth)
    const z = Math.max((rightmost + leftmost) / (2 * horizontal), (highest + lowest) / (2 * vertical));
    const position = new THREE.Vector3().addScaledVector(right, (rightmost - leftmost) / 2)
      .addScaledVector(up, (highest - lowest) / 2).addScaledVector(towards, z);
    const depth = points.map((point) => point.dot(towards));
    const target = position.clone().addScaledVector(towards, (Math.min(...depth) + Math.max(...depth)) / 2 - z);
    camera.near = this.size / 500;
    camera.far = this.size * 60;
    camera.position.copy(position);
    controls.target.copy(target);
    controls.minDistance = this.size / 50;
    controls.maxDistance = this.size * 20;
    controls.update();
    this.redraw();
  }
}

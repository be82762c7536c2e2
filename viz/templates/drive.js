// Moving the robot by hand: motors from sliders, passive joints from the loops, which are followed in small steps.
// Equations and names are those of viz/drive.py and calib/core/robots/loops.py.
"use strict";

const LARGEST_STEP = 0.02; // of motors, in radians or characteristic lengths, between two solutions
const CLOSED = 1e-10; // residual of closed loops, in radians or characteristic lengths
const NEWTON_STEPS = 12;
const NUDGE = 1e-7; // of a passive joint, to find slopes
const LIMIT_MARGIN = 1e-9; // how far beyond its limit a passive joint may be, as in calib

/** The vector log6 of a pose: translation part, then the rotation vector. */
function logarithm(m) {
  const cosine = Math.min(1, Math.max(-1, (m[0] + m[5] + m[10] - 1) / 2));
  const angle = Math.acos(cosine);
  const factor = angle < 1e-6 ? 0.5 : angle / (2 * Math.sin(angle));
  const w = [m[9] - m[6], m[2] - m[8], m[4] - m[1]].map((entry) => factor * entry);
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const p = [m[3], m[7], m[11]];
  const wp = cross(w, p);
  const wwp = cross(w, wp);
  const c = angle < 1e-4 ? 1 / 12 : (1 - angle * Math.sin(angle) / (2 * (1 - cosine))) / (angle * angle);
  return [...p.map((entry, i) => entry - wp[i] / 2 + c * wwp[i]), ...w];
}

/** Solve A x = b by elimination with pivots; returns x and the sign of the determinant (0: singular). */
function solveLinear(A, b) {
  const n = b.length;
  const rows = A.map((row, i) => [...row, b[i]]);
  let sign = 1;
  for (let k = 0; k < n; k += 1) {
    let best = k;
    for (let i = k + 1; i < n; i += 1) if (Math.abs(rows[i][k]) > Math.abs(rows[best][k])) best = i;
    if (Math.abs(rows[best][k]) < 1e-12) return { x: null, sign: 0 };
    if (best !== k) {
      [rows[k], rows[best]] = [rows[best], rows[k]];
      sign = -sign;
    }
    if (rows[k][k] < 0) sign = -sign;
    for (let i = k + 1; i < n; i += 1) {
      const part = rows[i][k] / rows[k][k];
      for (let j = k; j <= n; j += 1) rows[i][j] -= part * rows[k][j];
    }
  }
  const x = new Array(n).fill(0);
  for (let i = n - 1; i >= 0; i -= 1) {
    let sum = rows[i][n];
    for (let j = i + 1; j < n; j += 1) sum -= rows[i][j] * x[j];
    x[i] = sum / rows[i][i];
  }
  return { x, sign };
}

/** One robot, moved by its motors from a pose in which its loops are closed. */
class DrivenRobot {
  /**
   * @param robot placements of the tree, as Tree.poses reads them
   * @param tables what its motors do beside what they are told
   */
  constructor(tree, drive, robot, tables) {
    Object.assign(this, { tree, drive, robot, tables });
  }

  /** Start in a pose. @param values moving joints of that pose, loops closed. Returns whether they are. */
  start(motors, values) {
    this.motors = [...motors];
    this.passive = this.drive.columns.map((column) => values[column]);
    this.sign = 0;
    const found = this.newton(this.motors, this.passive); // the page's numbers are rounded
    if (found) {
      this.passive = found.passive;
      this.sign = found.sign;
    }
    return found !== null;
  }

  /** Where motors are when they are told these values: cubics through four numbers of each table. */
  actual(motors) {
    const actual = [...motors];
    this.tables.forEach(({ joint, axis, low, step, errors }) => {
      const place = (motors[axis] - low) / step;
      const first = Math.min(Math.max(Math.floor(place) - 1, 0), errors.length - 4);
      const t = place - first;
      const weights = [-(t - 1) * (t - 2) * (t - 3) / 6, t * (t - 2) * (t - 3) / 2, -t * (t - 1) * (t - 3) / 2,
        t * (t - 1) * (t - 2) / 6];
      weights.forEach((weight, i) => { actual[joint] += weight * errors[first + i]; });
    });
    return actual;
  }

  values(motors = this.motors, passive = this.passive) {
    const { by_actuated, by_passive, constant } = this.drive;
    const dot = (row, x) => row.reduce((sum, entry, i) => sum + entry * x[i], 0);
    const actual = this.actual(motors);
    return constant.map((value, i) => value + dot(by_actuated[i], actual) + dot(by_passive[i], passive));
  }

  /** How far the loops are open, in radians and characteristic lengths. */
  residual(motors, passive) {
    const poses = this.tree.poses(this.robot, this.values(motors, passive));
    return this.drive.loops.flatMap(({ a, b, full, rows }) => {
      const relative = multiply(invertRigid(poses[a]), poses[b]);
      const all = full ? logarithm(relative) : [relative[3], relative[7], relative[11]];
      return rows.map((row) => (row < 3 ? all[row] / this.drive.length : all[row]));
    });
  }

  /** Slopes of the residual by passive joints: rows are residuals. */
  slopes(motors, passive) {
    const columns = passive.map((_, k) => {
      const moved = (by) => this.residual(motors, passive.map((value, i) => value + (i === k ? by : 0)));
      const [more, less] = [moved(NUDGE), moved(-NUDGE)];
      return more.map((value, row) => (value - less[row]) / (2 * NUDGE));
    });
    return columns[0].map((_, row) => columns.map((column) => column[row]));
  }

  /** Passive joints that close the loops near a guess, with the sign of the slopes' determinant; null if none do. */
  newton(motors, guess) {
    if (!this.drive.loops.length) return { passive: [], sign: 1 };
    let passive = [...guess];
    for (let step = 0; step < NEWTON_STEPS; step += 1) {
      const residual = this.residual(motors, passive);
      const { x, sign } = solveLinear(this.slopes(motors, passive), residual);
      if (!x || !x.every(Number.isFinite)) return null;
      if (Math.max(...residual.map(Math.abs)) < CLOSED) return { passive, sign };
      passive = passive.map((value, i) => value - x[i]);
    }
    return null;
  }

  /** Move the motors as far towards these values as the loops allow. Returns whether they were reached. */
  moveTo(goal) {
    const scale = this.drive.sliding.map((slides) => (slides ? this.drive.length : 1));
    const far = Math.max(...goal.map((value, i) => Math.abs(value - this.motors[i]) / scale[i]), 0);
    const count = Math.max(1, Math.ceil(far / LARGEST_STEP));
    const from = this.motors;
    for (let step = 1; step <= count; step += 1) {
      const motors = from.map((value, i) => value + (goal[i] - value) * step / count);
      const found = this.newton(motors, this.passive);
      if (!found || found.sign !== this.sign || !found.passive.every((value, i) => this.allowed(value, i))) return false;
      this.motors = motors;
      this.passive = found.passive;
    }
    return true;
  }

  /** Whether a passive joint keeps its limits; a turning one may be counted from another turn. */
  allowed(value, i) {
    const [low, high] = this.drive.passive_range.map((ends) => ends[i]);
    if (low === null && high === null) return true;
    const turn = 2 * Math.PI;
    const turns = this.drive.turning[i] ? [0, turn, -turn] : [0];
    return turns.some((by) => (low === null || value + by >= low - LIMIT_MARGIN)
      && (high === null || value + by <= high + LIMIT_MARGIN));
  }

  /** Positions of the targets in the measurement frame [m]. */
  targets() {
    const own = { ...this.robot, root: null }; // also where the robot is drawn on the base of another
    const poses = this.tree.poses(own, this.values());
    return this.drive.targets.map(({ body }) => [poses[body][3], poses[body][7], poses[body][11]]);
  }
}

/** The sliders. */
class DrivePanel {
  /**
   * @param scene the page's scene
   * @param robots { solid, ghost } with `placements` and joint `values`; ghost may be null
   * @param show draws { joints, solid, ghost, targets, predicted }
   */
  constructor(scene, tree, robots, show) {
    Object.assign(this, { scene, robots, show });
    this.driven = Object.entries(robots).filter(([, robot]) => robot)
      .map(([name, robot]) => [name, new DrivenRobot(tree, scene.drive, robot, name === "solid" ? scene.drive.tables : [])]);
    this.note = document.getElementById("drive-note");
    this.sliders = scene.joints.map((joint, i) => this.slider(joint, i));
    const remarks = document.getElementById("drive-terms");
    remarks.textContent = scene.drive.remarks.join(" ");
    remarks.hidden = !scene.drive.remarks.length;
    document.getElementById("drive-block").hidden = !this.sliders.length;
  }

  slider(joint, i) {
    const [low, high] = this.scene.drive.range.map((ends) => joint.per_si * ends[i]);
    const id = `drive-${i}`;
    const input = element("input", { type: "range", id, min: low, max: high, step: (high - low) / 1000 });
    const output = element("output", { for: id });
    input.addEventListener("input", () => this.moved(i));
    document.getElementById("drive-sliders").append(element("div", { class: "row" },
      element("label", { for: id }, joint.name), input, output));
    return { input, output, joint };
  }

  /** The pose shown, from which a hand moves on. @param motors its joint values @param row its row of every robot's values */
  begin(motors, row) {
    this.start = { motors, row };
    this.note.textContent = "";
    this.write(motors);
  }

  /** Close the loops of the pose shown, when it is first moved on from. */
  get ready() {
    if (this.start) {
      const { motors, row } = this.start;
      this.closed = this.driven.every(([name, robot]) => robot.start(motors, valuesAt(this.robots[name], row)));
      this.start = null;
    }
    return this.closed;
  }

  moved(i) {
    if (!this.ready) {
      this.note.textContent = "The loops of this pose are not closed here: begin from another one.";
      return;
    }
    const { input, joint } = this.sliders[i];
    const start = this.driven[0][1].motors;
    const goal = start.map((value, k) => (k === i ? Number(input.value) / joint.per_si : value));
    const reached = this.driven[0][1].moveTo(goal);
    const { motors } = this.driven[0][1];
    // the nominal robot goes as far as the calibrated one; where it cannot, both stay behind
    const together = this.driven.slice(1).every(([, robot]) => robot.moveTo(motors));
    if (!together) this.driven[0][1].moveTo(this.driven[1][1].motors);
    this.note.textContent = reached && together ? "" : "The loops do not close beyond here.";
    this.write(this.driven[0][1].motors);
    this.show(this.state());
  }

  state() {
    const robots = Object.fromEntries(this.driven);
    const solid = this.scene.drive.complete ? robots.solid.targets() : null;
    const [before, after] = robots.ghost ? [robots.ghost.targets(), solid] : [solid, null];
    return { joints: this.driven[0][1].motors, solid: robots.solid.values(), ghost: robots.ghost ? robots.ghost.values() : null,
      targets: this.scene.drive.targets.map(({ name }) => name), byHand: true,
      predicted: { before, after } };
  }

  /** Sliders and numbers of motor values. */
  write(motors) {
    this.sliders.forEach(({ input, output, joint }, i) => {
      const value = joint.per_si * motors[i];
      input.value = value;
      output.textContent = `${fixed(value, 1)} ${joint.unit}`;
      input.setAttribute("aria-valuetext", output.textContent);
    });
  }
}

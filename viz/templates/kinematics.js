// How the robot moves: the same tree of joints and the same formulas as viz/bodies.py, which explains them.
// Matrices are arrays of 12 numbers: the upper three rows, row by row. All poses are in the measurement frame.
"use strict";

/** Product of two affine matrices. */
function multiply(a, b) {
  const c = new Array(12);
  for (let row = 0; row < 12; row += 4) {
    for (let column = 0; column < 4; column += 1) {
      c[row + column] = a[row] * b[column] + a[row + 1] * b[4 + column] + a[row + 2] * b[8 + column];
    }
    c[row + 3] += a[row + 3];
  }
  return c;
}

/** Inverse of a rotation with a translation. */
function invertRigid(a) {
  const r = [a[0], a[4], a[8], a[1], a[5], a[9], a[2], a[6], a[10]];
  const t = [a[3], a[7], a[11]];
  const moved = [0, 3, 6].map((i) => -(r[i] * t[0] + r[i + 1] * t[1] + r[i + 2] * t[2]));
  return [r[0], r[1], r[2], moved[0], r[3], r[4], r[5], moved[1], r[6], r[7], r[8], moved[2]];
}

/** Turn by an angle about a unit axis (Rodrigues), or slide along it. */
function jointMotion(axis, value, slides) {
  const [x, y, z] = axis;
  if (slides) {
    return [1, 0, 0, value * x, 0, 1, 0, value * y, 0, 0, 1, value * z];
  }
  const c = Math.cos(value);
  const s = Math.sin(value);
  const d = 1 - c;
  return [c + d * x * x, d * x * y - s * z, d * x * z + s * y, 0,
          d * x * y + s * z, c + d * y * y, d * y * z - s * x, 0,
          d * x * z - s * y, d * y * z + s * x, c + d * z * z, 0];
}

/** A robot's joint values in a pose. */
function valuesAt({ values, width }, pose) {
  return values.subarray(pose * width, (pose + 1) * width);
}

class Tree {
  /** @param bodies parents, axes, sliding, columns, base: see Bodies in viz/bodies.py. */
  constructor(bodies) {
    Object.assign(this, bodies);
  }

  /** Pose T of every body, for one row of joint values. */
  poses(robot, values) {
    const poses = [[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]];
    this.parents.forEach((parent, i) => {
      let pose = multiply(poses[parent], robot.placements[i]);
      if (this.columns[i] >= 0) {
        pose = multiply(pose, jointMotion(this.axes[i], values[this.columns[i]], this.sliding[i]));
      }
      poses.push(pose);
    });
    const back = robot.root || invertRigid(poses[this.base]);
    return poses.map((pose) => multiply(back, pose));
  }

  /** M = T S of every body. */
  matrices(robot, values) {
    return this.poses(robot, values).map((pose, body) => multiply(pose, robot.stretches[body]));
  }

  /** M_solid + factor (M_ghost - M_solid). */
  exaggerated(solid, ghost, factor) {
    return solid.map((matrix, body) => matrix.map((entry, i) => entry + factor * (ghost[body][i] - entry)));
  }
}

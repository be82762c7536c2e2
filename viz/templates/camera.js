// Where the camera must stand so that the whole scene is seen, and no link and no measured point lies under the legend.
"use strict";

const FIELD_OF_VIEW = 36; // [deg], vertical
const MARGIN = 30; // free edge [px], for the ring around an outermost point

/**
 * Nearest camera that sees all points inside a part of the pane.
 *
 * A camera at `a` along its right axis and at the depth z sees a point (r, d) between the lines of sight with slopes s0
 * and s1 if s0 (z - d) <= r - a <= s1 (z - d). With R = max(r + s1 d) and L = max(-r - s0 d) over all points this is
 * R <= a + s1 z and L <= -a - s0 z, so z >= (R + L) / (s1 - s0); the same upwards. The larger z of both serves both.
 *
 * @param points [right, up, towards] of each in the camera's axes
 * @param part left, top, right, bottom of the pane's part [px]
 * @returns right, up, towards of the camera
 */
function cameraThatSees(points, [left, top, right, bottom], width, height) {
  const steepest = Math.tan(FIELD_OF_VIEW * Math.PI / 360);
  const slopes = (low, high, size, scale) => [(2 * low / size - 1) * scale, (2 * high / size - 1) * scale];
  const across = slopes(left, right, width, steepest * width / height);
  const upwards = slopes(height - bottom, height - top, height, steepest);
  const most = (axis, [low, high]) => [Math.max(...points.map((p) => p[axis] + high * p[2])),
    Math.max(...points.map((p) => -p[axis] - low * p[2]))];
  const nearest = ([R, L], [low, high]) => (R + L) / (high - low);
  const middle = ([R, L], [low, high], z) => (R - high * z - L - low * z) / 2;
  const sides = most(0, across);
  const ends = most(1, upwards);
  const z = Math.max(nearest(sides, across), nearest(ends, upwards));
  return [middle(sides, across, z), middle(ends, upwards, z), z];
}

/** Look with a stage's camera from a direction (upright frame, z up), as near as the whole scene allows. */
function look(stage, direction) {
  const { THREE } = stage;
  const { camera, controls } = stage.viewer;
  const turned = ([x, y, z]) => new THREE.Vector3(x, z, -y); // meshcat's camera lives where y is up
  const towards = turned(direction).normalize();
  const right = new THREE.Vector3().crossVectors(new THREE.Vector3(0, 1, 0), towards).normalize();
  const up = new THREE.Vector3().crossVectors(towards, right);
  const points = [...stage.scene.view.outline.map(turned), ...stage.livePlaces()].map((p) => [p.dot(right), p.dot(up), p.dot(towards)]);
  const width = stage.pane.clientWidth;
  const height = stage.pane.clientHeight;
  const edge = Math.min(MARGIN, width / 10, height / 10);
  const depths = points.map((point) => point[2]);
  const middle = (Math.min(...depths) + Math.max(...depths)) / 2;
  camera.fov = FIELD_OF_VIEW;
  camera.near = stage.size / 500;
  camera.far = stage.size * 60;
  controls.minDistance = stage.size / 50;
  controls.maxDistance = stage.size * 20;
  const stand = (part) => {
    const [a, b, z] = cameraThatSees(points, part, width, height);
    camera.position.set(0, 0, 0).addScaledVector(right, a).addScaledVector(up, b).addScaledVector(towards, z);
    controls.target.copy(camera.position).addScaledVector(towards, middle - z);
    controls.update();
    camera.updateMatrixWorld();
    camera.updateProjectionMatrix();
    return z;
  };
  stand([edge, edge, width - edge, height - edge]);
  const legend = stage.legendBox();
  if (legend && stage.anythingUnder(legend)) {
    const free = [[edge, edge, width - edge, legend[1] - edge], [legend[2] + edge, edge, width - edge, height - edge]];
    const [above, beside] = free.map((part) => (part[2] - part[0] > 50 && part[3] - part[1] > 50 ? stand(part) : Infinity));
    if (Number.isFinite(Math.min(above, beside))) stand(free[above <= beside ? 0 : 1]);
  }
  stage.redraw();
}

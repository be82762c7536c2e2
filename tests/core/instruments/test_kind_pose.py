"""Full poses: forms of rotations, a known truth found again, intervals that hold it, bad input."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binom

import calib
from calib.core.data.measurement_files import format_measurements, read_measurements
from calib.core.instruments.pose import Pose, PoseSection
from calib.core.rows.registration import register
from tests.six_axis_arm import HEAD, joints, write_six_axis

YAML = f"""\
{HEAD}base: {{frame: l0, pose: unknown}}
targets:
  cell: {{frame: l6, xyz: [50 mm, 20 mm, 100 mm], position: unknown, orientation: unknown, sigma: 5 mm,
         sigma_angle: 20 mrad}}
instruments:
  tracker: {{kind: pose, target: cell}}
parametrisation:
  - {{origin: all, components: [x, y, z], sigma: 1 mm}}
  - {{origin: all, components: [rx, ry, rz], sigma: 3 mrad}}
"""
FORMS = ("quaternion", "rpy", "intrinsic_xyz", "intrinsic_zyx", "intrinsic_zyz", "rotation_vector", "matrix")
BASE = Rotation.from_rotvec([0.4, -1.9, 2.2])


def arm(folder, yaml=YAML):
    return calib.load(write_six_axis(folder, yaml))


@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_rotation_is_read_back(tmp_path, form):
    robot = arm(tmp_path, YAML.replace("target: cell}", f"target: cell, rotation: {form}}}"))
    q = joints(5, 4)
    data = calib.simulate(robot, q, 0.0, np.random.default_rng(0))
    path = tmp_path / "data.csv"
    path.write_text(format_measurements(robot, data))
    again = read_measurements(path, robot).readings["tracker"].values
    before, after = (Rotation.from_rotvec(values[:, 3:].copy()) for values in (data.readings["tracker"].values, again))
    assert np.max((before.inv() * after).magnitude()) < 1e-12
    assert np.allclose(again[:, :3], data.readings["tracker"].values[:, :3], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("form", "sequence"), [("rpy", "xyz"), ("intrinsic_xyz", "XYZ"), ("intrinsic_zyx", "ZYX"), ("intrinsic_zyz", "ZYZ")]
)
def test_angles_mean_what_their_form_says(form, sequence):
    instrument = Pose.from_section("t", PoseSection(kind="pose", rotation=form))
    angles = np.array([[0.3, -0.4, 1.2]])
    # elementary rotations written out: fixed axes multiply from the left, moving ones from the right
    c, s = np.cos(angles[0]), np.sin(angles[0])
    about = {
        "x": lambda k: np.array([[1, 0, 0], [0, c[k], -s[k]], [0, s[k], c[k]]]),
        "y": lambda k: np.array([[c[k], 0, s[k]], [0, 1, 0], [-s[k], 0, c[k]]]),
        "z": lambda k: np.array([[c[k], -s[k], 0], [s[k], c[k], 0], [0, 0, 1]]),
    }
    factors = [about[axis.lower()](k) for k, axis in enumerate(sequence)]
    expected = factors[0] @ factors[1] @ factors[2] if sequence.isupper() else factors[2] @ factors[1] @ factors[0]
    columns = dict(
        zip([column.name for column in instrument.columns()], np.hstack([np.zeros((1, 3)), angles]).T, strict=True)
    )
    result = Rotation.from_rotvec(instrument.values(columns)[:, 3:].copy()).as_matrix()[0]
    assert np.allclose(result, expected, rtol=0, atol=1e-12)


def test_base_and_sensor_frame_are_placed_from_anywhere(tmp_path):
    robot = arm(tmp_path)
    q = joints(12, 5)
    mounted = Rotation.from_rotvec([1.1, -2.0, 0.7])
    T = robot.forward(q, "l6")
    link = np.linalg.inv(robot.forward(q[:1] * 0, "l0")[0]) @ T  # flange in the robot's own base link
    R, p = Rotation.from_matrix(link[:, :3, :3]), link[:, :3, 3]
    where = np.array([3.0, -5.0, 1.0]) + BASE.apply(p + R.apply([0.11, -0.07, 0.19]))
    turned = BASE * R * mounted
    loose = arm(tmp_path, YAML.replace(", sigma: 5 mm,\n         sigma_angle: 20 mrad", ""))
    data = calib.as_measurements(loose, q, {"tracker": np.hstack([where, turned.as_rotvec()])})
    result = register(loose, data).forward(q, "cell")
    assert np.allclose(result[:, :3, 3], where, rtol=0, atol=1e-8)
    assert np.max((Rotation.from_matrix(result[:, :3, :3]).inv() * turned).magnitude()) < 1e-7


BY_AXES = "sigma: [0.02 mm, 0.02 mm, 0.1 mm], sigma_angle: [0.05 mrad, 0.2 mrad, 0.05 mrad]"
ALIKE = "sigma: 0.02 mm, sigma_angle: 0.05 mrad"


@pytest.mark.quick(0)
@pytest.mark.amount(0, 20)
@pytest.mark.parametrize(("noise", "shared"), [(BY_AXES, 0.0), (ALIKE, 2e-4)], ids=["by axes", "shared by a visit"])
def test_intervals_of_predictions_hold_the_truth(tmp_path, amount, noise, shared):
    robot = arm(tmp_path, YAML.replace("target: cell}", f"target: cell, {noise}}}"))
    sigma = np.array([p.sigma_si for p in robot.parameters])
    placed = np.array([p.placement and not p.prior for p in robot.parameters])
    rng, inside = np.random.default_rng(10), 0
    for _ in range(amount):
        truth = robot.with_parameters(robot.values + np.where(placed, 0.1, sigma * rng.standard_normal(len(sigma))))
        fit = calib.fit(robot, calib.simulate(truth, rng.uniform(-1.5, 1.5, (30, 6)), None, rng, joint_sigma=shared))
        other = rng.uniform(-1.5, 1.5, (1, 6))
        prediction = fit.predict(other)
        error = np.abs(prediction.positions - truth.positions(other))
        inside += int(np.sum(error <= prediction.coverage_factor * prediction.std))
    # coordinates of one position are not independent: the bound is that of the positions alone
    assert inside >= 3 * int(binom.ppf(1e-3, amount, 0.95))

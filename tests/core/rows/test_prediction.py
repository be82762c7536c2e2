import csv
import itertools
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.core.base.contributions import names_of
from calib.core.robots.terms.terms import parse_terms
from calib.core.rows.prediction import PositionUncertainty, order_of_joints, recombined_joints
from calib.shared.candidates import rows_of_poses
from tests.kind_checks import positions_by_joint
from tests.project import write_table
from tests.six_axis_arm import FREE, YAML, joints, noisy, write_six_axis

SIGMA = 4e-5


@pytest.fixture(scope="module")
def fit(arm):
    return calib.fit(arm, noisy(arm, joints(60), SIGMA, seed=1))


@pytest.mark.quick(0)
@pytest.mark.amount(800, 3000)
def test_the_covariance_is_that_of_drawn_parameters_and_of_joints_off_by_what_is_left_out(fit, amount):
    q = joints(4, seed=5)
    by_joint = positions_by_joint(fit.robot, q)[:, 0]
    left_out = fit.joint_error**2 * by_joint @ by_joint.swapaxes(1, 2)
    prediction = replace(fit.uncertainty, undecided=None).predict(fit.robot, q)
    rng = np.random.default_rng(2)
    drawn = rng.multivariate_normal(np.zeros(fit.free.sum()), fit.covariance.values, size=amount)
    positions = []
    for step in drawn:
        values = fit.robot.values.copy()
        values[fit.free] += step
        positions.append(fit.robot.with_parameters(values).positions(q))
    for k in range(4):
        simulated = np.cov(np.array(positions)[:, k, 0].T) + left_out[k]
        size = np.max(np.abs(simulated))
        away = 3 * np.sqrt(2 / amount) * size  # three standard errors
        np.testing.assert_allclose(prediction.covariance[k, 0], simulated, atol=away)


def test_where_the_side_of_a_backlash_is_unknown_positions_are_as_uncertain_as_both_sides_are_apart(
    tmp_path, run_calib
):
    terms = "".join(f"  - {{joint: {name}, term: backlash, sigma: 0.3 mrad}}\n" for name in ("j2", "j4"))
    arm = calib.load(write_six_axis(tmp_path, YAML + FREE + terms))
    truth = arm.with_parameters({"j2.backlash": 4e-4, "j4.backlash": -3e-4})
    rng = np.random.default_rng(3)
    named = tuple(map(str, range(200)))
    fit = calib.fit(arm, calib.simulate(truth, calib.Poses(joints(200, 1), named, named, "simulated", ()), 1e-7, rng))
    q = joints(5, seed=5)
    poses = calib.Poses(q, named[:5], named[:5], "further", ())
    sides = []
    for second, fourth in itertools.product((1.0, -1.0), repeat=2):
        from_side = replace(poses, approach=np.tile([1.0, second, 1.0, fourth, 1.0, 1.0], (5, 1)))
        sides.append(truth.positions(q, from_side.conditions)[:, 0])
        assert np.max(fit.predict(from_side).std) < 2e-7  # known but for the noise
    predicted = fit.predict(poses)
    np.testing.assert_allclose(predicted.positions[:, 0], np.mean(sides, axis=0), atol=1e-6)
    spread = np.mean([off[:, :, None] * off[:, None] for off in sides - np.mean(sides, axis=0)], axis=0)
    np.testing.assert_allclose(predicted.covariance[:, 0], spread, rtol=0.01, atol=1e-3 * np.max(spread))
    assert fit.claim_at(poses).rms == pytest.approx(np.sqrt(np.mean(np.trace(spread, axis1=1, axis2=2))), rel=0.01)
    assert "unknown directions of approach" in names_of(predicted.contains)
    fit.save(tmp_path / "out", force=True, pages=False)
    table = write_table(tmp_path / "poses.csv", [f"j{k} [rad]" for k in range(1, 7)], q)
    run = run_calib("predict", arm.path, table, "--result", tmp_path / "out", "--out", tmp_path / "predicted.csv")
    assert run.code == 0
    assert "add approach_j2, approach_j4 (+1 or -1)" in " ".join((run.out + run.err).split())


def test_predict_says_at_which_temperature_and_time_positions_are_if_poses_do_not(tmp_path, run_calib):
    terms = "".join(f"  - {{joint: j2, term: {term}}}\n" for term in ("temperature", "drift"))
    arm, named, rng = calib.load(write_six_axis(tmp_path, YAML + FREE + terms)), tuple(map(str, range(80))), 3
    context = {"temperature": np.linspace(20.0, 30.0, 80)[::-1] ** 1.5 / 5.0, "time": np.arange(80.0)}
    poses = calib.Poses(joints(80, 1), named, named, "simulated", (), context=context)
    calib.fit(arm, calib.simulate(arm, poses, SIGMA, rng)).save(tmp_path / "out", force=True, pages=False)
    for columns, words in (
        ((), "temperature, time; positions are those at temperature 20 degC, time 0"),
        (("time [s]",), "temperature;"),
    ):
        header, rows = [f"j{k} [rad]" for k in range(1, 7)], joints(4, seed=5)
        table = write_table(
            tmp_path / "poses.csv", [*header, *columns], np.column_stack([rows, *[np.ones(4)] * len(columns)])
        )
        run = run_calib("predict", arm.path, table, "--result", tmp_path / "out", "--out", tmp_path / "new.csv")
        assert f"has no column {words}" in " ".join((run.out + run.err).split())


def test_the_summary_names_mean_rms_largest_and_the_worst_pose(fit):
    prediction = fit.predict(np.vstack([joints(10, seed=5), 2.9 * np.ones((1, 6))]))
    distance = 1e3 * np.sqrt(np.trace(prediction.covariance[:, 0], axis1=1, axis2=2))
    assert prediction.worst == int(np.argmax(distance))
    summary = prediction.summary()
    assert summary["mean"] == pytest.approx(distance.mean())
    assert summary["rms"] == pytest.approx(np.sqrt(np.mean(distance**2)))
    assert summary["max"] == pytest.approx(distance.max())


TWO_TARGETS = """\
urdf: arm.urdf
name_mot: [j1, j2, j3, j4, j5, j6]
base: {frame: l0, pose: POSE}
targets:
  body: {frame: l6, position: unknown}
  ball: {frame: l6, xyz: [50 mm, 20 mm, 100 mm]}
  tip: {frame: l6, xyz: [0, 0, 200 mm]}
instruments: {OTHER, eye: {kind: pixel, target: body, camera: {frame: l0, PLACE},
              intrinsics: {fx: 2400, fy: 2410, cx: 1000, cy: 800}, points: {a: [0, 0, 0], b: [0, 50 mm, 0]}}}
parametrisation:
"""
BALL = "ball: {kind: position}"
KNOWN = "pose: known, xyz: [2, 0, 0]"


@pytest.mark.parametrize(
    ("other", "pose", "place", "left_out"),
    [
        (BALL, "known", "", {"body": 0}),
        (BALL, "unknown", "", {"body": 0}),  # the measurement frame is the tracker's then
        (BALL, "known", KNOWN, {}),
        ("level: {kind: orientation, target: ball}", "known", "", {}),  # nobody reads a position: all count
        ("wire: {kind: distance, target: ball, end: {frame: l0, xyz: [2, 0, 0]}}", "known", "", {"body": 0}),
    ],
)
def test_targets_read_from_unknown_places_only_do_not_count_beside_others(tmp_path, other, pose, place, left_out):
    text = TWO_TARGETS.replace("OTHER", other).replace("POSE", pose).replace("PLACE", place).replace(", }", "}")
    robot = calib.load(write_six_axis(tmp_path, text + FREE))
    assert robot.unreported_targets == left_out
    q = joints(5)
    rows = rows_of_poses(robot, robot.assemble(q), SIGMA).position_rows
    assert rows.shape[1] == 3 * (3 - len(left_out))  # nobody reads the tip, and it counts all the same
    covariance = np.zeros((5, 3, 3, 3))
    covariance[:, 0], covariance[:, 1:] = np.eye(3), 1e-6 * np.eye(3)
    known = PositionUncertainty(robot.positions(q), covariance, 2.0, left_out=robot.unreported_targets)
    expected = 1e3 * np.sqrt(3) * (1e-3 if left_out else (1 + 2e-3) / 3)  # mm, by hand
    assert known.summary()["mean"] == pytest.approx(expected)
    assert ("body (known to 1.7e+03 mm)" in known.remark()) == bool(left_out)


def test_predict_writes_a_standard_deviation_for_each_coordinate(fit, tmp_path, run_calib):
    fit.save(tmp_path / "out")
    q = joints(3, seed=5)
    poses = write_table(tmp_path / "poses.csv", [f"j{k} [rad]" for k in range(1, 7)], q)
    out = tmp_path / "predicted.csv"
    files = ("--result", tmp_path / "out", "--out", out, "--json", tmp_path / "p.json")
    run = run_calib("predict", fit.nominal.path, poses, *files)
    assert run.code == 0, run.err
    table = list(csv.DictReader(line for line in out.read_text().splitlines() if not line.startswith("#")))
    std = 1e3 * fit.predict(q).std[:, 0]
    for axis, name in enumerate("xyz"):
        written = [float(row[f"ball_std_{name} [mm]"]) for row in table]
        np.testing.assert_allclose(written, std[:, axis], rtol=1e-9)
    content = json.loads((tmp_path / "p.json").read_text())
    assert content["position_uncertainty"]["max"] == pytest.approx(fit.predict(q).summary()["max"])
    assert "at worst (pose" in run.out
    run = run_calib("predict", fit.nominal.path, poses, "--out", out, "--force")  # of a robot without a result
    assert run.code == 0, run.err
    assert "std" not in out.read_text()
    assert "known to" not in run.out


def test_other_combinations_keep_the_values_of_each_joint_and_break_what_they_do_together():
    path = np.linspace(0.0, 1.0, 30)[:, None] + np.arange(6.0)  # all joints move as one
    mixed = recombined_joints(path, 100)
    assert mixed.shape == path.shape
    np.testing.assert_array_equal(np.sort(mixed, axis=0), path)
    assert np.max(np.abs(np.corrcoef(mixed.T) - np.eye(6))) < 0.6
    assert len(recombined_joints(path, 10)) == 10


def test_other_combinations_do_not_depend_on_the_order_of_joints_and_the_signs_of_axes():
    rng = np.random.default_rng(4)
    for _ in range(20):
        q, order, signs = rng.uniform(-2, 2, (40, 6)), rng.permutation(6), rng.choice([-1.0, 1.0], 6)
        other, (places, ways) = q[:, order] * signs, order_of_joints(q)
        np.testing.assert_array_equal(recombined_joints(other, 15), recombined_joints(q, 15)[:, order] * signs)
        np.testing.assert_array_equal(order_of_joints(other), [places[order], ways[order] * signs])


WIRES = """\
urdf: arm.urdf
name_mot: [j1, j2, j3, j4, j5, j6]
base: {frame: l0}
targets: {ball: {frame: l6, xyz: [50 mm, 20 mm, 100 mm], position: unknown, sigma: 2 mm}}
instruments:
  one: {kind: distance, target: ball, end: {frame: l0, xyz: [-1.4, 0, 0.2], position: unknown}, sigma: 0.02 mm}
  two: {kind: distance, target: ball, end: {frame: l0, xyz: [1, 1, 0], position: PLACE}, sigma: 0.02 mm}
  three: {kind: distance, target: ball, end: {frame: l0, xyz: [0, -1.2, 0], position: PLACE}, sigma: 0.02 mm}
parametrisation:
  - {origin: all, components: [x, y, z], sigma: 1 mm}
  - {origin: all, components: [rx, ry, rz], sigma: 3 mrad}
"""


@pytest.mark.quick(0)
def test_a_base_that_nobody_measured_does_not_count_in_how_well_positions_are_known(tmp_path, run_calib):
    """Lengths from unknown points leave millimetres to where the robot stands, and micrometres to what it does."""
    robot = calib.load(write_six_axis(tmp_path, WIRES.replace("PLACE", "unknown")))
    rng, q = np.random.default_rng(11), joints(60, seed=3)
    free = np.array([parameter.prior for parameter in robot.parameters]) & robot.is_free
    sigma = np.array([parameter.sigma_si for parameter in robot.parameters])
    truth = robot.with_parameters(robot.values + sigma * free * rng.standard_normal(len(sigma)))
    fit = calib.fit(robot, calib.simulate(truth, q, None, 5))
    known = fit.identification_uncertainty
    there, positions = truth.positions(q)[:, 0], fit.robot.positions(q)[:, 0]
    turn, _ = Rotation.align_vectors(there - there.mean(axis=0), positions - positions.mean(axis=0))
    off = turn.apply(positions - positions.mean(axis=0)) - (there - there.mean(axis=0))
    told = 1e-3 * known.summary()["rms"]
    assert 0.5 < np.sqrt(np.mean(np.sum(off**2, axis=1))) / told < 2  # few directions of one draw
    assert known.measured.summary()["mean"] > 100 * known.summary()["mean"]
    assert "in the robot's own base frame" in fit.report(verbose=True)
    fit.save(tmp_path / "out", pages=False)
    table = json.loads((tmp_path / "out" / "result.json").read_text())["position_uncertainty"]["identification"]
    assert table["frame"] == "robot base"
    assert table["measurement_frame"]["mean"] == pytest.approx(known.measured.summary()["mean"])
    (tmp_path / "q.csv").write_text("j1,j2,j3,j4,j5,j6\n0.1,0.2,0.3,0.1,0.2,0.3\n")
    run = run_calib("predict", tmp_path / "out", tmp_path / "q.csv", "--out", tmp_path / "p.csv")
    assert re.search(r"known to 0\.0\d+ mm on average.*own base frame.*in the measurement frame to [\d.]+ mm", run.out)
    lines = (tmp_path / "p.csv").read_text().splitlines()
    written = next(csv.DictReader(line for line in lines if not line.startswith("#")))
    std = 1e3 * fit.predict([0.1, 0.2, 0.3, 0.1, 0.2, 0.3]).std[0, 0]
    assert float(written["ball_std_x [mm]"]) == pytest.approx(std[0])  # of the coordinate beside it


def test_a_point_at_a_known_place_makes_the_measurement_frame_count(tmp_path):
    robot = calib.load(write_six_axis(tmp_path, WIRES.replace("PLACE", "known")))
    fit = calib.fit(robot, calib.simulate(robot, joints(60, seed=3), None, 5))
    assert fit.identification_uncertainty.frame == ""
    assert fit.identification_uncertainty.summary() == fit.predict(joints(60, seed=3)).summary()


@pytest.mark.parametrize(("reach", "further"), [(1.0, False), (0.3, True)])
def test_predict_says_what_the_fit_claims_at_these_poses(arm, tmp_path, run_calib, reach, further):
    """Measured in all of the space, or in a part of it, where errors of parameters do less than elsewhere."""
    fit = calib.fit(arm, noisy(arm, reach * joints(60), 4e-5, 1))
    fit.save(tmp_path / "out", pages=False)
    q = joints(20, 7)
    write_table(tmp_path / "q.csv", "j1,j2,j3,j4,j5,j6", q)
    run = run_calib("predict", arm.path, "q.csv", "--result", "out", "--out", "p.csv", cwd=tmp_path)
    claim = fit.verdict.claim
    told, there = claim.at_measured_poses, np.mean(fit.predict(q).distance ** 2)
    grown = np.sqrt(1 + max(there - claim.rms**2, 0.0) / told.rms**2)
    here = fit.claim_at(q)
    assert (here.times, here.rms) == (pytest.approx(grown), pytest.approx(grown * told.rms))
    assert (here.times > 1.05) == further
    like = "at poses like the 60 measured"
    end = f". This is {here.times:.2g} times as far as {like}" if further else f", {like}"
    said = f"The real tool is within {1e3 * here.limit95:.3g} mm of these positions, 95 % of the time{end}"
    assert said in " ".join(run.out.split())


@pytest.mark.quick(0)
@pytest.mark.amount(1, 6)
def test_what_is_expected_at_further_poses_like_those_measured_is_what_is_claimed(arm, amount):
    """Simulated, a curve of each joint from few poses: positions of poses that were used are known far better."""
    robot = arm.with_terms(parse_terms("curve"))
    expected = [_errors_of_a_fit(robot, 1.0, 45, seed)[0] for seed in range(amount)]
    assert np.sqrt(np.mean(np.square(expected))) == pytest.approx(1.0, abs=0.37 / np.sqrt(amount))


def test_what_is_expected_beyond_the_poses_measured_is_nearer_the_truth(arm):
    """Simulated: measured in a part of the joints' range, and asked for in all of it."""
    ratios = [_errors_of_a_fit(arm, 0.3, 60, seed) for seed in range(5)]
    expected, claimed = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert claimed > 1.5
    assert 0.75 < expected < 1.33


def _errors_of_a_fit(robot, reach, n, seed):
    """Errors of a fit to n poses at others, over what is expected there, and over what is claimed where measured."""
    rng = np.random.default_rng(seed)
    off = [0.0 if p.placement else p.sigma_si * rng.standard_normal() for p in robot.parameters]
    true = robot.with_parameters(robot.values + np.where(robot.is_free, off, 0.0))
    fit = calib.fit(robot, noisy(true, reach * joints(n, seed), SIGMA, seed))
    q = joints(300, 50 + seed)
    read = noisy(true, q, SIGMA, 100 + seed).points(true)
    error = np.sqrt(np.mean(np.sum((fit.robot.positions(q) - read) ** 2, axis=2)))
    return error / fit.claim_at(q).rms, error / fit.verdict.claim.at_measured_poses.rms


def test_no_poses_have_no_summary(fit):
    nothing = fit.predict(np.zeros((0, 6)))
    assert all(np.isnan(nothing.summary()[key]) for key in ("mean", "rms", "max"))
    assert str(nothing.table()["mean"]) == "nan"
    assert isinstance(nothing.remark(), str)
    with pytest.raises(calib.InputError, match="no poses"):
        _ = nothing.worst

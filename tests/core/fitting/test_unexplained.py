"""Errors of joints that no parameter describes count in predicted positions, as far as residuals show them.

`python -m tests.core.fitting.test_unexplained 100` prints a table of docs/uncertainty.md; a further number is the seed.
With `--lacking`, it prints that of models that lack a kind of error, and whose noise is not stated.
"""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

import calib
from calib.core.base.threads import one_blas_thread
from calib.core.fitting.terms.kind_model import KindModel
from calib.core.numerics.mixed_model import MixedModel
from calib.core.numerics.mixed_rows import FLAT, MixedRows
from calib.core.numerics.size_search import likeliest_sizes, scatter_given_noise
from calib.core.results.result_reading import load_result
from tests.core.fitting.test_term_choice import entries
from tests.project import EXAMPLES, copied

NOISE, SIZE = 3e-5, 1e-4
"""Noise of positions [m], and root mean square error of each joint [rad]."""
ORDERS = {"none": (), "smooth": (1, 3, 2), "rough": (20, 100, 3)}
"""Least and largest number of waves in a radian of a joint, and how many waves there are."""


def example(name):
    return calib.load(EXAMPLES / f"{name}.yaml")


def joint_errors(q, shape, size, rng):
    """Errors of each joint by its own value: sums of sines, (n, n_joints) [rad]."""
    off = np.zeros_like(q)
    if ORDERS[shape]:
        low, high, n = ORDERS[shape]
        for j in range(q.shape[1]):
            waves = [np.sin(rng.uniform(low, high) * q[:, j] + rng.uniform(0, 2 * np.pi)) for _ in range(n)]
            off[:, j] = size * np.sqrt(2 / n) * np.sum(waves, axis=0)
    return off


def simulated(robot, shape, rng, *, n=60, size=SIZE, again=1):
    """Measured poses of a robot with errors of origins and joints; other commands and where they bring it."""
    sigma = np.array([0.0 if p.placement else p.sigma_si for p in robot.parameters])
    true = robot.with_parameters(robot.values + 0.3 * sigma * rng.standard_normal(len(sigma)))
    if robot.passive_names:
        q = robot.home + rng.uniform(-0.4, 0.4, (n + 200, len(robot.joint_names)))
    else:
        low, high = robot.joint_limits.T
        q = low + (high - low) * rng.uniform(0.15, 0.85, (n + 200, len(low)))
    points = true.positions(q + joint_errors(q, shape, size, rng))[:, 0]
    measured = np.repeat(np.arange(n), again)
    read = points[measured] + NOISE * rng.standard_normal((n * again, 3))
    return q[measured], read, q[n:], points[n:]


def test_of_very_many_poses_only_those_that_sizes_are_found_from_are_observed(robot, monkeypatch):
    fit = calib.fit(robot, calib.simulate(robot, robot.sample(700, seed=1), seed=2))
    model = KindModel(fit, ())
    observe = mock.Mock(wraps=calib.core.fitting.terms.kind_model.observe)
    monkeypatch.setattr("calib.core.fitting.terms.kind_model.observe", observe)
    read = model.informative_rows
    rows = model.rows(read, fit.scales, np.ones(1, dtype=bool))
    assert [len(call.args[1].actuated) for call in observe.call_args_list] == [350]
    np.testing.assert_allclose(rows.columns, fit.rows.jacobian[read], rtol=1e-9, atol=1e-9)


def held(fit, q, points):
    """Part of the 95 % intervals of single coordinates that hold the true one."""
    predicted = fit.predict(q)
    moves = predicted.std[:, 0] > 1e-9  # the pen of the five-bar stays in its plane
    inside = np.abs(predicted.positions[:, 0] - points) <= predicted.coverage_factor * predicted.std[:, 0]
    return float(np.mean(inside[moves]))


def fitted(robot, shape, seed, **options):
    """A fit of simulated measurements, and the part of intervals that hold."""
    q, read, elsewhere, points = simulated(robot, shape, np.random.default_rng(seed), **options)
    fit = calib.fit(robot, calib.as_measurements(robot, q, read), sigma=NOISE)
    return fit, held(fit, elsewhere, points)


@one_blas_thread
def main(n, seed):
    """Print the table."""
    print("| robot | errors of joints | found [mrad] | in how many fits [%] | positions in their intervals [%] |")
    print("|---|---|---:|---:|---:|")
    for name in ("arm", "five_bar"):
        robot = example(name)
        cases = [("none", 0.0), *(("rough", size) for size in (2e-5, 4e-5)), ("smooth", SIZE), ("rough", SIZE)]
        for shape, size in cases:
            results = [fitted(robot, shape, [seed, k], size=size) for k in range(n)]
            errors = np.array([fit.joint_error for fit, _ in results])
            words = "none" if shape == "none" else f"{shape}, {1e3 * size:g} mrad"
            print(
                f"| {robot.name.replace('_', ' ')} | {words} | {1e3 * np.mean(errors):.3f} |"
                f" {100 * np.mean(errors > 0):.0f} | {100 * np.mean([part for _, part in results]):.1f} |",
                flush=True,
            )


@pytest.mark.quick(1)
@pytest.mark.parametrize(("name", "shape"), [("arm", "smooth"), ("arm", "rough"), ("five_bar", "rough")])
def test_positions_of_a_robot_whose_joints_are_off_lie_in_their_intervals(name, shape):
    """They held 64, 65 and 73 % where noise alone counted. 200 poses of 6 fits scatter by 1 to 2 %."""
    robot = example(name)
    results = [fitted(robot, shape, [1, seed]) for seed in range(6)]
    assert 0.89 < np.mean([part for _, part in results]) < 0.98
    mean = np.mean([fit.joint_error for fit, _ in results])
    assert 0.5 * SIZE < mean < 1.3 * SIZE  # origins take up a part of smooth ones


def test_errors_too_small_for_a_test_of_the_residuals_count():
    """With 150 poses, where a test at 5 % saw every second set, 88 % were held."""
    results = [fitted(example("arm"), "rough", [6, seed], n=150, size=2e-5) for seed in range(6)]
    assert 0.905 < np.mean([part for _, part in results]) < 0.98
    assert np.mean([fit.joint_error for fit, _ in results]) == pytest.approx(2e-5, rel=0.4)


@pytest.mark.quick(0)
@pytest.mark.parametrize("name", ["arm", "five_bar"])
def test_a_robot_that_its_parameters_describe_is_hardly_less_certain(name):
    """Noise alone makes the estimate larger than 0 in half of all fits, but not by much."""
    results = [fitted(example(name), "none", [2, seed]) for seed in range(6)]
    wider = []
    for fit, _ in results:
        q = fit.identification.data.joints
        alone = replace(fit.uncertainty, joint_error=0.0).predict(fit.robot, q)
        wider.append(fit.predict(q).distance.mean() / alone.distance.mean())
    assert np.median(wider) < 1.1
    assert 0.9 < np.mean([part for _, part in results]) < 0.995


def test_errors_count_as_much_beside_a_target_that_is_known_to_half_a_metre(tmp_path):
    found = []
    for sigma in ("", ", sigma: 500 mm"):  # 5e4 of the noise, and rows move the target by 54 mm
        text = "xyz: [0, 0, 0], position: unknown" + sigma
        path = copied(
            tmp_path, EXAMPLES / "arm.yaml", ("xyz: [20 mm, 0 mm, 50 mm], position: unknown, sigma: 5 mm", text)
        )
        found.append(calib.fit(path, EXAMPLES / "arm_simulated.csv", sigma=2e-5).joint_error)
    assert found[0] > 1e-5
    assert found[1] == pytest.approx(found[0], rel=0.03)


def test_gross_errors_at_few_poses_are_no_errors_of_joints(robot):
    """They were 0.77 mrad; without gross errors 0.005 mrad is found on average."""
    q, read, _, _ = simulated(robot, "none", np.random.default_rng(7))
    read[[11, 30, 52]] += 50 * NOISE * np.random.default_rng(8).standard_normal((3, 3))
    fit = calib.fit(robot, calib.as_measurements(robot, q, read), sigma=NOISE)
    assert fit.joint_error < 2.5e-5


def test_what_is_added_is_the_lever_of_each_joint(robot):
    """By the equation, with derivatives by differences, in the frame of the measurement and for turns too."""
    fit, _ = fitted(robot, "rough", 3)
    q = fit.identification.data.joints[:4]
    predicted = fit.predict(q)
    alone = replace(fit.uncertainty, joint_error=0.0).predict(fit.robot, q)
    step = 1e-6
    levers = np.stack(
        [(fit.robot.positions(q + step * e) - fit.robot.positions(q - step * e))[:, 0] / (2 * step) for e in np.eye(6)],
        axis=2,
    )
    added = fit.joint_error**2 * levers @ levers.swapaxes(1, 2)
    np.testing.assert_allclose(predicted.covariance[:, 0] - alone.covariance[:, 0], added, rtol=1e-5, atol=1e-14)
    turns = predicted.turn_covariance - alone.turn_covariance
    assert np.trace(turns[0, 0]) == pytest.approx(6 * fit.joint_error**2, rel=1e-6)  # each of six joints turns it


def silent(folder):
    """The example arm, whose noise is not stated."""
    return calib.load(copied(folder, EXAMPLES / "arm.yaml", ("sigma: 0.03 mm\n", "")))


@pytest.mark.parametrize("again", [1, 2])
def test_errors_of_joints_are_told_from_noise_that_is_not_stated(tmp_path, again):
    """By the directions in which joints move the tool, and by repeats: without repeats, they all counted as noise."""
    robot = silent(tmp_path)
    q, read, elsewhere, points = simulated(robot, "rough", np.random.default_rng(4), again=again)
    fit = calib.fit(robot, calib.as_measurements(robot, q, read, [str(k // again) for k in range(len(q))]))
    assert fit.joint_error == pytest.approx(SIZE, rel=0.3)
    assert 0.88 < held(fit, elsewhere, points) < 0.99


@pytest.mark.quick(1)
@pytest.mark.parametrize("kind", ["gain", "harmonics", "curve", "compliance", "coupling"])
def test_a_term_that_the_model_lacks_counts_where_noise_is_not_stated(tmp_path, kind):
    """Error over standard deviation, each of three robots; of couplings it was up to 2.7."""
    ratios = [_error_over_std(silent(tmp_path), kind, np.random.default_rng(104 + 10 * seed)) for seed in range(3)]
    assert 0.7 < min(ratios) < max(ratios) < 1.3


def test_a_robust_loss_does_not_make_the_noise_of_readings_smaller():
    """Weights make residuals smaller; noise from these would be a quarter too small, and good poses outliers."""
    robot, rng = example("arm"), np.random.default_rng(100)
    data = calib.simulate(robot, rng.uniform(-2.0, 2.0, (60, 6)), seed=100, sigma=5e-5)
    fit = calib.fit(robot, data, loss="cauchy")
    assert fit.joint_error > 0.0
    assert fit.reading_noise[0] == pytest.approx(5e-5, rel=0.15)


def test_what_rows_cannot_tell_from_noise_counts_as_errors_of_joints():
    """A gantry: three joints move every reading alike, in all directions."""
    rng, n = np.random.default_rng(9), 40
    joints, errors = np.tile(np.eye(3), (n, 1)), 1e-4 * rng.standard_normal(3 * n)
    one, pose, term = np.zeros(3 * n, dtype=int), np.repeat(np.arange(n), 3), np.sin(np.arange(3 * n))
    columns, family = np.column_stack([joints, term]), np.array([FLAT, FLAT, FLAT, 0])

    def found(size, stated, by_term=0.0):
        y = size * (errors + by_term * term)
        rows = MixedRows(columns, y, family, one, np.array([stated]), pose, size * joints)
        return scatter_given_noise(likeliest_sizes(MixedModel.from_rows(rows)))

    assert found(1.0, stated=False) == pytest.approx(1e-4, rel=0.5)
    assert found(1.0, stated=False, by_term=0.01) == pytest.approx(1e-4, rel=0.5)  # what a term explains is no scatter
    assert found(1e4, stated=True) < 5e-5


def test_a_result_keeps_it_and_every_text_counts_it(robot, tmp_path, run_calib, with_pages):
    fit, _ = fitted(robot, "rough", 5)
    fit.save(tmp_path / "out")
    assert load_result(tmp_path / "out").uncertainty.joint_error == fit.joint_error
    said = "counting what the model leaves out"
    assert said in " ".join(fit.report(verbose=True).split())
    assert said in (tmp_path / "out" / "report.html").read_text()
    (tmp_path / "poses.csv").write_text(",".join(robot.joint_names) + "\n" + ",".join(["0.3"] * 6) + "\n")
    files = ("poses.csv", "--result", "out", "--out", "predicted.csv")
    run = run_calib("predict", EXAMPLES / "arm.yaml", *files, cwd=tmp_path)
    assert said in " ".join(run.out.split())


def test_an_encoder_that_no_parameter_moves_keeps_the_noise_that_its_readings_show(tmp_path):
    """Its rows say nothing of errors of joints; readings of the same noise then agree with the calibration."""
    instruments = (
        "instruments:\n  ball: {kind: position, target: reflector}\n  dial: {kind: joint_reading, joint: joint_2}\n"
    )
    path = copied(tmp_path, EXAMPLES / "arm.yaml", ("sigma: 0.03 mm", instruments))
    robot, rng = calib.load(path), np.random.default_rng(1)
    q = np.repeat(calib.sample(robot, 40, seed=5).joints, 2, axis=0)
    exact = {"ball": robot.positions(q)[:, 0], "dial": q[:, [1]]}
    read = {name: values + NOISE * rng.standard_normal(values.shape) for name, values in exact.items()}
    data = calib.as_measurements(robot, q, read, [f"{k // 2}" for k in range(len(q))])
    used, unseen = data.split(validation=0.25, seed=1)
    fit = calib.fit(robot, used)
    assert fit.reading_noise == pytest.approx([NOISE, NOISE], rel=0.3)  # three standard errors of 60 readings
    assert calib.verify(fit, unseen).verdict == "agrees"


@one_blas_thread
def lacking(n):
    """Print error over standard deviation where the model lacks a kind of error and noise is not stated."""
    with tempfile.TemporaryDirectory() as folder:
        robot = silent(Path(folder))
        print("| what the model lacks | smallest to largest |\n|---|---|")
        for k, kind in enumerate(("harmonics", "curve", "compliance", "gain", "coupling", "")):
            ratios = [_error_over_std(robot, kind, np.random.default_rng(100 + k + 10 * seed)) for seed in range(n)]
            print(f"| {kind or 'nothing'} | {min(ratios):.2f} to {max(ratios):.2f} |", flush=True)


def _error_over_std(robot, kind, rng):
    true = robot.with_terms(entries(robot, (kind,))) if kind else robot
    sigma = np.array([0.0 if p.name in robot.description.held else p.sigma_si for p in true.parameters])
    true = true.with_parameters(true.values + sigma * rng.standard_normal(len(sigma)))
    q = rng.uniform(-1.5, 1.5, (140, len(robot.joint_names)))
    read = true.positions(q[:70])[:, 0] + NOISE * rng.standard_normal((70, 3))
    predicted = calib.fit(robot, calib.as_measurements(robot, q[:70], read)).predict(q[70:])
    off = np.sum((predicted.positions[:, 0] - true.positions(q[70:])[:, 0]) ** 2, axis=1)
    return np.sqrt(np.mean(off) / np.mean(predicted.distance**2))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("n", nargs="?", type=int, default=20, help="simulated robots in each row")
    parser.add_argument("seed", nargs="?", type=int, default=1)
    parser.add_argument("--lacking", action="store_true", help="of models that lack a kind of error")
    options = parser.parse_args()
    if options.lacking:
        lacking(options.n)
    else:
        main(options.n, options.seed)

"""Errors in a place where nothing was fitted: setups left out in turn, and validation in a setup of its own."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from tests.project import write_table
from tests.six_axis_arm import FREE, YAML, joints, six_axis_arm, write_six_axis

SIGMA = 4e-5
PLACES = {"left": (0.3, 2.0, 0.1), "middle": (0.0, -1.0, 0.4), "right": (-2.0, 0.5, 0.0)}
"""Setups of the tracker, and where it reads the arm's base [m]."""


def moving(folder, places):
    """The arm whose tracker was put up anew for each of some setups."""
    yaml = YAML.replace("base: {frame: l0}", "base: {frame: l0, pose: unknown}")
    setups = ", ".join(f"{name}: [{'base' if k else ''}]" for k, name in enumerate(places))
    folder.mkdir(exist_ok=True)
    return calib.load(write_six_axis(folder, f"{yaml}{FREE}setups: {{{setups}}}\n"))


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """Joint values, and what was read, of each setup; the third joint is off by what no parameter describes."""
    arm, rng = six_axis_arm(tmp_path_factory.mktemp("true")), np.random.default_rng(1)
    true = arm.with_parameters({"j2.x": 0.0512, "j3.z": 0.5991, "j4.ry": 2e-3})
    result = {}
    for k, (name, shift) in enumerate(PLACES.items()):
        q = joints(40, seed=k)
        points = true.positions(q + [[0, 0, 3e-4, 0, 0, 0]] * np.sin(3 * q[:, :1]))[:, 0]
        turn = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]] if k % 2 else np.eye(3)
        result[name] = q, points @ np.transpose(turn) + shift + SIGMA * rng.standard_normal(points.shape)
    return result


def written(path, measured, places):
    header = [*(f"j{k} [rad]" for k in range(1, 7)), *(f"ball_{a} [m]" for a in "xyz"), "setup"]
    read = ((*row, name) for name in places for row in zip(*measured[name], strict=True))
    return write_table(path, header, *zip(*read, strict=True))


def laid_through(predicted, points):
    """Root mean square distance of points from predicted ones that are moved onto them as one body."""
    _, distance = Rotation.align_vectors(points - points.mean(axis=0), predicted - predicted.mean(axis=0))
    return distance / np.sqrt(len(points))


def others(left_out):
    return [name for name in PLACES if name != left_out]


@pytest.mark.quick(0)
def test_each_setup_is_predicted_by_a_fit_of_the_others_and_placed_anew(tmp_path, measured):
    robot = moving(tmp_path, PLACES)
    data = calib.read_measurements(written(tmp_path / "all.csv", measured, PLACES), robot)
    fit = calib.fit(robot, data, folds="setups")
    expected = []
    for k, name in enumerate(PLACES):
        alone = moving(tmp_path / name, others(name))
        read = calib.read_measurements(written(tmp_path / f"{k}.csv", measured, others(name)), alone)
        q, points = measured[name]
        expected.append(laid_through(calib.fit(alone, read).robot.positions(q)[:, 0], points))
    np.testing.assert_allclose(fit.folds.rms, expected, rtol=1e-4)
    assert np.all(np.array(expected) > 2 * SIGMA)
    figures = ", ".join(f"{name} {1e3 * rms:.4f}" for name, rms in zip(PLACES, fit.folds.rms, strict=True))
    said = f"Setups left out in turn, each placed anew: RMS of {figures} mm"
    assert said in " ".join(fit.report(verbose=True).split())
    assert fit.folds.setups == (0, 1, 2)


@pytest.mark.quick(1)
@pytest.mark.parametrize("later", PLACES)
def test_validation_in_a_setup_that_the_data_do_not_have_is_placed_by_itself(tmp_path, measured, later):
    robot = moving(tmp_path, PLACES)
    data, held = (
        calib.read_measurements(written(tmp_path / f"{name}.csv", measured, places), robot)
        for name, places in (("used", others(later)), ("later", [later]))
    )
    fit = calib.fit(robot, data, validation=held)
    origin = "base" if later == "left" else f"base@{later}"
    assert fit.placed_later == tuple(f"{origin}.{component}" for component in ("x", "y", "z", "rx", "ry", "rz"))
    q, points = measured[later]
    rms = {}
    for state, placed in (("after", fit.robot), ("before", robot)):
        rms[state] = np.sqrt(np.mean(np.sum(fit.validation.errors(state) ** 2, axis=1)))
        assert rms[state] == pytest.approx(laid_through(placed.positions(q)[:, 0], points), rel=1e-4)
    assert rms["before"] > 3 * rms["after"]
    # the arm's base as the tracker reads it, from where the tracker stands on the arm
    where = dict(zip((p.name for p in fit.robot.parameters), fit.robot.values, strict=True))
    distance = np.linalg.norm([where[f"{origin}.{axis}"] for axis in "xyz"])
    assert distance == pytest.approx(np.linalg.norm(PLACES[later]), abs=5e-3)
    said = f"Places found by unused poses, because only these show them: {origin} "
    assert said in " ".join(fit.report(verbose=True).split())
    assert {fit.parameters[name].status for name in fit.placed_later} == {"placed"}
    assert "Held at nominal" not in fit.report(verbose=True)
    assert robot.is_free.sum() == fit.robot.is_free.sum() == len(fit.free_names) + 6


def test_folds_that_are_neither_a_number_nor_setups_are_errors(tmp_path, measured, run_calib):
    robot = moving(tmp_path, PLACES)
    path = written(tmp_path / "one.csv", measured, ["left"])
    data, elsewhere = calib.read_measurements(path, robot), [p.name for p in robot.parameters if "@" in p.name]
    with pytest.raises(calib.InputError, match=r"folds setups: .*one.csv has one setup only"):
        calib.fit(robot.fix(*elsewhere), data, folds="setups")
    with pytest.raises(calib.InputError, match="folds 'setup': must be a number of folds, or 'setups'"):
        calib.fit(robot, data, folds="setup")
    run = run_calib("fit", tmp_path / "arm.yaml", path, "--folds", "places", "--out", tmp_path / "out")
    assert run.code == 2
    assert "--folds places: must be a number of folds, or 'setups'" in " ".join(run.err.split())
    assert not (tmp_path / "out").exists()


@pytest.mark.quick(0)
def test_the_command_leaves_setups_out(tmp_path, measured, run_calib):
    moving(tmp_path, PLACES)
    path = written(tmp_path / "all.csv", measured, PLACES)
    run = run_calib("fit", tmp_path / "arm.yaml", path, "--folds", "setups", "--verbose", "--out", tmp_path / "out")
    assert run.code == 0, run.err
    assert "Setups left out in turn, each placed anew: RMS of left" in " ".join(run.out.split())
    assert '"setups": [\n' in (tmp_path / "out" / "result.json").read_text()

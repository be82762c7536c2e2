"""The first guess of someone who knows numpy, pandas, lmfit, scikit-learn or Pinocchio runs as it is typed."""

import copy
from pathlib import Path

import numpy as np
import pytest

import calib
from tests.whole.conftest import ARM, READ


def same(item, other):
    return np.allclose(item.robot.values, other.robot.values, rtol=0, atol=1e-9)


RUN = {
    # numpy and pandas: rows, masks, length, tables
    "mask of poses": lambda t: len(t.candidates[np.arange(40) < 5]) == 5,
    "row after row": lambda t: [cell.names[0] for cell in t.data] == list(t.data.names),
    "columns of data": lambda t: np.allclose(
        t.data.to_dict(t.robot)["reflector_x [mm]"], 1e3 * t.data.readings["reflector"].values[:, 0]
    ),
    "columns of poses": lambda t: (
        list(t.candidates.to_dict(t.robot)) == ["pose"] + [f"joint_{k} [deg]" for k in range(1, 7)]
    ),
    "html of data": lambda t: "<table>" in t.data._repr_html_(),
    # data as paths, data frames, dictionaries of columns
    "fit(robot, path)": lambda t: same(calib.fit(t.robot, READ), calib.fit(t.robot, t.data)),
    "fit(path, path)": lambda t: calib.fit(ARM, READ, validation=READ).validation.data.n_poses == 80,
    "fit(robot, Path)": lambda t: calib.fit(t.robot, Path(READ), terms="none").converged,
    "fit(robot, frame)": lambda t: np.allclose(
        calib.fit(t.robot, t.frame).robot.values, calib.fit(t.robot, t.data).robot.values, atol=1e-12
    ),
    "fit(robot, q, xyz)": lambda t: same(
        calib.fit(t.robot, t.data.joints, t.data.points()[:, 0]), calib.fit(t.robot, t.data)
    ),
    "solve(robot, T)": lambda t: np.allclose(
        t.robot.forward(calib.solve(t.robot, t.robot.forward(t.q)).q), t.robot.forward(t.q), atol=1e-6
    ),
    "with_parameters(text)": lambda t: (
        t.robot.with_parameters({"joint_3.z": "441 mm"}).values.max()
        == t.robot.with_parameters({"joint_3.z": 0.441}).values.max()
    ),
    "fit(robot, [a, b])": lambda t: len(calib.read_measurements([t.frame, t.frame], t.robot)) == 160,
    "read_measurements(frame)": lambda t: np.allclose(calib.read_measurements(t.frame, t.robot).joints, t.data.joints),
    "read_measurements(dict)": lambda t: len(calib.read_measurements(t.data.to_dict(), t.robot)) == 80,
    "read_poses(frame)": lambda t: calib.read_poses(t.frame, t.robot).joints.shape == (80, 6),
    "check(robot, path)": lambda t: calib.check(t.robot, READ).n_poses == 80,
    "check(robot, frame)": lambda t: calib.check(ARM, t.frame).n_poses == 80,
    "select(robot, path)": lambda t: len(calib.select(t.robot, READ, 30).joints) == 30,
    "select(robot, frame)": lambda t: len(calib.select(t.robot, t.frame, count=30).joints) == 30,
    "predict(frame)": lambda t: t.fit.predict(t.frame).positions.shape == (80, 1, 3),
    "simulate(path of a robot)": lambda t: len(calib.simulate(ARM, t.q, "0.04 mm", seed=1)) == 5,
    "sample(path of a robot)": lambda t: len(calib.sample(ARM, 5, seed=1)) == 5,
    "read_measurements(path, path)": lambda t: len(calib.read_measurements(READ, ARM)) == 80,
    "as_measurements(path, q, xyz)": lambda t: len(calib.as_measurements(ARM, t.q, t.q[:, :3])) == 5,
    "predict(path, q)": lambda t: calib.predict(ARM, t.q).positions.shape == (5, 1, 3),
    "solve(path, positions)": lambda t: calib.solve(ARM, calib.load(ARM).positions(t.q)[:, 0]).ok.all(),
    "check(robot)": lambda t: calib.check(t.robot).n_poses == 100,
    "as_measurements(path)": lambda t: len(calib.as_measurements(t.robot, READ)) == 80,
    "as_measurements(q, xyz)": lambda t: np.allclose(
        calib.as_measurements(t.robot, t.data.joints, t.data.points()[:, 0]).points(), t.data.points()
    ),
    # fit: names, priors, noise, what is held out
    "fix=": lambda t: calib.fit(t.robot, t.data, fix=["joint_3.z"]).parameters["joint_3.z"].status == "held",
    "free= and nothing else": lambda t: (
        moving(t, calib.fit(t.robot, t.data, fix="all", free=["joint_3.z", "joint_4.x"])) == ["joint_3.z", "joint_4.x"]
    ),
    "free=": lambda t: calib.fit(t.robot.fix("joint_3.z"), t.data, free="joint_3.z").parameters["joint_3.z"].std > 0,
    "prior=": lambda t: (
        calib.fit(t.robot, t.data, prior={"joint_3.z": "0.1 um"}).parameters["joint_3.z"].value
        == pytest.approx(440, abs=1e-3)
    ),
    "prior= of a place": lambda t: (
        calib.fit(t.robot, t.data, prior={"reflector.x": "0.1 um"}).parameters["reflector.x"].value
        == pytest.approx(20, abs=1e-3)
    ),
    "sigma= with a unit": lambda t: calib.fit(t.robot, t.data, sigma="0.03 mm").sigma_stated == pytest.approx(3e-5),
    "sigma= of each row": lambda t: np.allclose(
        calib.fit(t.robot, t.data, sigma=np.full(80, 3e-5)).robot.values,
        calib.fit(t.robot, t.data, sigma=3e-5).robot.values,
        atol=1e-9,
    ),
    "sigma= of each axis": lambda t: calib.fit(t.robot, t.data, sigma=np.full((80, 3), 3e-5)).converged,
    # results
    "verify(fit, path)": lambda t: calib.verify(t.fit, READ).verdict == "agrees",
    "verify(load_result(folder), path)": lambda t: (
        t.fit.save(t.folder / "saved") is None
        and calib.verify(calib.load_result(t.folder / "saved"), READ).p_value
        == pytest.approx(calib.verify(t.fit, t.data).p_value, rel=1e-6)
    ),
    "summary": lambda t: t.fit.summary().startswith("Calibration of") and t.fit.summary() in t.fit.report(),
    "to_dict": lambda t: t.fit.to_dict()["n_poses"] == 60,
    "errors": lambda t: (
        t.fit.errors["validation"]["after"]["rms"] == t.fit.to_dict()["errors"]["validation"]["after"]["rms"]
    ),
    "rms": lambda t: 1e3 * t.fit.rms == pytest.approx(t.fit.errors["validation"]["after"]["rms"]),
    "correlation": lambda t: t.fit.correlation["joint_3.z", "joint_3.z"] == pytest.approx(1.0),
    "cross_validate": lambda t: np.mean(t.fit.cross_validate(3, seed=1).rms) == pytest.approx(5e-5, rel=0.5),
    "residuals as an array": lambda t: (
        1e3 * np.sqrt(3.0) * np.std(t.fit.residuals)
        == pytest.approx(t.fit.errors["identification"]["after"]["rms"], rel=0.01)  # their mean is near zero
    ),
    "residuals in mm": lambda t: np.array_equal(t.fit.residuals * 1e3, 1e3 * t.fit.residuals["reflector"]),
    "the first residuals": lambda t: t.fit.residuals[:2].shape == (2, 3),
    "the shape of what is predicted": lambda t: np.shape(t.fit.predict(t.q)) == (5, 1, 3),
    "predicted minus measured": lambda t: np.array_equal(
        t.fit.predict(t.data) - t.data.points(), t.fit.predict(t.data).positions - t.data.points()
    ),
    "z of what is predicted": lambda t: np.array_equal(
        t.fit.predict(t.q)[..., 2], t.fit.predict(t.q).positions[..., 2]
    ),
    "bootstrap": lambda t: len(t.fit.bootstrap(4, seed=1).parameters) == len(t.fit.free_names),
    "progress= of a bootstrap": lambda t: progress_of(lambda told: t.fit.bootstrap(3, progress=told))[-1] == (3, 3),
    "plot()": lambda t: t.fit.plot().get_xlabel().endswith("[mm]"),
    "plot.residuals()": lambda t: t.fit.plot.residuals().get_xlabel() == "joint_1 [deg]",
    "export with format=": lambda t: (
        t.fit.export(t.folder / "arm.txt", format="mjcf") is None and "<mujoco" in (t.folder / "arm.txt").read_text()
    ),
    "nominal beside calibrated": lambda t: np.any(t.fit.nominal.values != t.fit.robot.values),
    # robots
    "jacobian of one": lambda t: t.robot.jacobian(t.q[0], "flange").shape == (6, 6),
    "joint_limits": lambda t: t.robot.joint_limits.shape == (6, 2) and t.robot.joint_limits[0, 1] == 2.9,
    "limits of a joint by name": lambda t: t.robot.joint_limits["joint_2"].tolist() == [-1.6, 2.2],
    "compensate(fit, T)": lambda t: np.allclose(
        calib.compensate(t.fit, t.fit.nominal.forward(t.q)).q, calib.compensate(t.fit, t.q, keep="pose").q, atol=1e-8
    ),
    "to_dict with noise": lambda t: np.allclose(
        calib.fit(
            t.robot, calib.fit(t.robot, t.data, sigma=np.linspace(2e-5, 9e-5, 80)).identification.data.to_dict()
        ).robot.values,
        calib.fit(t.robot, t.data, sigma=np.linspace(2e-5, 9e-5, 80)).robot.values,
        atol=1e-9,
    ),
    "frame_names": lambda t: "flange" in t.robot.frame_names,
    "forward of a list": lambda t: t.robot.forward([0.0] * 6, "flange").shape == (4, 4),
    "in robot.parameters": lambda t: "joint_3.z" in t.robot.parameters and "joint_9.z" not in t.robot.parameters,
    "if fit": lambda t: all((t.fit, t.robot, t.data)),
    # scikit-learn: split, fit, predict, seed
    "the same seed": lambda t: (
        t.data.split(validation=0.25, seed=1)[0].names == t.data.split(validation=0.25, seed=1)[0].names
    ),
    "another seed": lambda t: (
        t.data.split(validation=0.25, seed=1)[0].names != t.data.split(validation=0.25, seed=2)[0].names
    ),
    "fit then predict": lambda t: t.fit.predict(t.held.joints).positions.shape == (20, 1, 3),
    "predict of a fit": lambda t: np.array_equal(calib.predict(t.fit, t.held).std, t.fit.predict(t.held.joints).std),
    "predict of measurements": lambda t: np.array_equal(t.fit.predict(t.held).std, t.fit.predict(t.held.joints).std),
    "predict of a list": lambda t: t.fit.predict([[0.0] * 6]).positions.shape == (1, 1, 3),
    "predict of a robot": lambda t: np.all(np.isnan(calib.predict(t.robot, t.held).std)),
    "predict of one pose": lambda t: calib.predict(t.fit, t.held.joints[0]).positions.shape == (1, 1, 3),
    "folds with a seed": lambda t: calib.fit(t.robot, t.data, folds=2, seed=3).folds.seed == 3,
    "starts with a seed": lambda t: calib.fit(t.robot, t.used, starts=2, seed=3).seed == 3,
    "a robot is copied": lambda t: copy.deepcopy(t.robot).parameters == t.robot.parameters,
    # lmfit: parameters by name, reports, intervals, covariance
    "membership": lambda t: "joint_3.z" in t.fit.parameters and "nobody" not in t.fit.parameters,
    "html of a fit": lambda t: "joint_3.z" in t.fit._repr_html_(),
    "parameter of a robot": lambda t: t.robot.parameters["joint_3.z"].nominal == 440,
    "parameters of a robot in a row": lambda t: t.robot.parameters[:2] == tuple(t.robot.parameters)[:2],
    # the words of the command line, and what was saved
    "html of a check": lambda t: "joint_3.z" in calib.check(t.robot, t.candidates)._repr_html_(),
    "html of a selection": lambda t: "O1" in calib.select(t.robot, t.candidates, 20)._repr_html_(),
    "sample of a robot": lambda t: np.array_equal(t.robot.sample(5, seed=1), calib.sample(t.robot, 5, seed=1).joints),
    "html of a robot": lambda t: "joint_3.z" in t.robot._repr_html_(),
    "load what was saved": lambda t: (
        calib.load_result(t.saved).parameters["joint_3.z"].std == pytest.approx(t.fit.parameters["joint_3.z"].std)
    ),
    "predict with what was saved": lambda t: np.allclose(
        calib.load_result(t.saved).predict(t.held.joints).std, t.fit.predict(t.held.joints).std, rtol=1e-9
    ),
    "covariance of what was saved": lambda t: (
        calib.load_result(t.saved).covariance["joint_3.z", "joint_4.x"]
        == pytest.approx(t.fit.covariance["joint_3.z", "joint_4.x"])
    ),
    "html of what was saved": lambda t: "joint_3.z" in calib.load_result(t.saved)._repr_html_(),
}
"""Lines that run as they are typed."""


def moving(t, fit):
    """The free parameters of a fit that do not only say where base and target are."""
    return [name for name in fit.free_names if not t.robot.parameters[name].placement]


def progress_of(call):
    told = []
    call(lambda done, total: told.append((done, total)))
    return told


@pytest.mark.quick(9)
@pytest.mark.parametrize("guess", RUN)
def test_a_guess_runs(t, guess):
    if "plot" in guess:
        pytest.importorskip("matplotlib.pyplot").switch_backend("agg")
    assert RUN[guess](t)


def test_axes_that_are_given_are_drawn_into(t):
    figure = pytest.importorskip("matplotlib.figure").Figure()
    for draw in (t.fit.plot.errors, t.fit.plot.by_pose, t.fit.plot.normal):
        figure.clear()
        axes = figure.gca()
        assert draw(axes) is axes
    assert t.fit.plot.residuals("joint_2", axes=figure.gca()).get_ylabel() == "residual [mm]"
    figure.clear()
    assert len(t.fit.plot.parameters(figure.gca()).get_yticks()) == 36

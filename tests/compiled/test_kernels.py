"""Compiled kinematics against Pinocchio's, which is the reference: every kind of robot that the tests have."""

import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import calib
from calib.core.robots.acceleration import compile_for, compile_kinematics, kernels
from calib.core.robots.continuation import newton
from calib.core.robots.jacobian import linearise
from calib.core.rows.observed import observe
from medrue import robot_file
from medrue.workspace import target_workspace
from tests.core.instruments.test_kind_joint_reading import five_bar as five_bar_with_encoder
from tests.core.robots.test_jacobian import by_every_origin
from tests.project import EXAMPLES
from tests.six_axis_arm import joints, six_axis_arm
from tests.small_robots import small_arm, write_parallelogram, write_pose_loop
from tests.starting import test_loop_templates as templates

pytest.importorskip("numba", reason="numba is not installed (extra 'fast')")
SAME = 1e-12
"""Of lengths and angles of order one; both sides round."""


def around_home(robot, reach=0.1, count=12):
    return robot.home + np.random.default_rng(5).uniform(-reach, reach, (count, len(robot.joint_names)))


def medrue(name):
    return calib.load(robot_file(name)), np.array(target_workspace().q)[::20]


def example(name):
    robot = calib.load(EXAMPLES / f"{name}.yaml")
    return robot, calib.read_measurements(EXAMPLES / f"{name}_simulated.csv", robot).joints[:20]


def template(folder, name):
    robot = templates.robot_of(folder, name)
    reach = templates.REACH[name]
    off = np.random.default_rng(3).uniform(-reach, reach, (12, len(robot.joint_names)))
    return robot, robot.home + off


ROBOTS = {
    "MedRUE": lambda folder: medrue("medrue"),
    "MedRUE, extended": lambda folder: medrue("medrue_extended"),
    "five-bar": lambda folder: example("five_bar"),
    "arm": lambda folder: example("arm"),
    "six axes": lambda folder: (six_axis_arm(folder), joints(12)),
    "small arm, sliding": lambda folder: (small_arm(folder), around_home(small_arm(folder))),
    "parallelogram": lambda folder: ((robot := calib.load(write_parallelogram(folder))), around_home(robot)),
    "encoder on a passive joint": lambda folder: ((robot := five_bar_with_encoder(folder)), around_home(robot)),
} | {f"template {name}": lambda folder, name=name: template(folder, name) for name in templates.TEMPLATES}


@pytest.fixture(params=ROBOTS)
def case(request, tmp_path):
    """A robot whose parameters are off by a tenth of their sigma, and poses."""
    robot, q = ROBOTS[request.param](tmp_path)
    sigma = np.array([parameter.sigma_si for parameter in robot.parameters])
    off = np.random.default_rng(2).uniform(-0.1, 0.1, len(sigma)) * sigma * robot.is_free
    return robot, robot.with_parameters(robot.values + off), q


@pytest.mark.quick(1)
def test_closed_loops_are_those_of_the_reference(case):
    robot, moved, q = case
    seed = robot.assemble(q).passive
    for start in (None, seed):
        expected = moved.assemble(q, start)
        with compile_kinematics():
            assert kernels(moved.mechanism, len(q)) is not None
            assembled = moved.assemble(q, start)
        # loops are closed to 1e-12 m, and far from singular poses passive joints as well as that
        assert np.allclose(assembled.passive, expected.passive, rtol=0, atol=20 * SAME)
        no_slope = start is not None and bool(robot.passive_names)
        assert (assembled.slope is None) == (expected.slope is None) == no_slope
        if start is None:
            assert np.allclose(assembled.slope, expected.slope, rtol=0, atol=20 * SAME)
    where = moved.mechanism, robot.mode, expected.actuated, expected.passive
    if moved.passive_names:
        expected_slopes = newton(*where)[1:3]
        with compile_kinematics():
            for slope, known in zip(newton(*where)[1:3], expected_slopes, strict=True):
                assert np.allclose(slope, known, rtol=0, atol=20 * SAME)


def test_derivatives_are_those_of_the_reference(case):
    _, moved, q = case
    there = moved.assemble(q)
    read = calib.simulate(moved, q, 0.0).readings
    plain, every = linearise(moved, there), by_every_origin(moved, there)
    observed = observe(moved, there, read, joints=True)
    with compile_kinematics():
        assert np.allclose(linearise(moved, there).positions, plain.positions, rtol=0, atol=SAME)
        assert np.allclose(linearise(moved, there).jacobian, plain.jacobian, rtol=SAME, atol=SAME)
        assert np.allclose(by_every_origin(moved, there), every, rtol=SAME, atol=SAME)
        for name, item in observe(moved, there, read, joints=True).items():
            assert np.allclose(item.residuals, observed[name].residuals, rtol=0, atol=SAME)
            assert np.allclose(item.jacobian, observed[name].jacobian, rtol=SAME, atol=SAME)
            assert np.allclose(item.joint_derivative, observed[name].joint_derivative, rtol=SAME, atol=SAME)


def test_poses_that_cannot_close_are_refused_alike():
    robot, q = example("five_bar")
    q = np.vstack([q, [[3.1, 0.05]]])  # both motors stretched away from each other
    expected = robot.close(q)
    with compile_kinematics():
        result = robot.close(q)
    assert not expected.ok[-1]
    assert np.array_equal(result.ok, expected.ok)


def test_loops_of_directions_are_left_to_the_reference(tmp_path):
    robot = calib.load(write_pose_loop(tmp_path))
    with compile_kinematics():
        assert kernels(robot.mechanism, 10) is None


@pytest.mark.quick(0)
def test_numba_is_loaded_only_where_it_is_asked_for():
    check = (
        "import sys, calib; robot = calib.load(sys.argv[1]); robot.assemble(robot.home); print('numba' in sys.modules)"
    )
    command = [sys.executable, "-c", check, EXAMPLES / "five_bar.yaml"]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "False\n"


@pytest.mark.parametrize("kept", [True, False])
def test_it_is_worth_loading_for_many_poses_and_for_fewer_if_an_earlier_program_has_compiled(monkeypatch, kept):
    monkeypatch.setattr("calib.compiled.kernels.is_compiled", lambda *_: kept)
    for name, fewer in (("five_bar", 5000), ("arm", 20_000)):  # a pose without loops saves less
        mechanism = calib.load(EXAMPLES / f"{name}.yaml").mechanism
        assert kernels(mechanism, fewer - 1) is None
        assert (kernels(mechanism, fewer) is not None) is kept
        assert kernels(mechanism, 7 * fewer) is not None
        with compile_kinematics(False), compile_for(300_000):
            assert kernels(mechanism, 300_000) is None
        for task, pays in ((1000, False), (20_000, kept), (300_000, True)):
            with compile_for(task):  # a task of many poses, whose parts may be small
                assert (kernels(mechanism, 10) is not None) is pays


@pytest.mark.parametrize(("written", "kept"), [(1.0, True), (-1.0, False)])
def test_compiled_code_is_kept_until_the_file_changes(monkeypatch, tmp_path, written, kept):
    functions = import_module("calib.compiled.kernels")
    monkeypatch.setattr(functions, "motion", SimpleNamespace(stats=SimpleNamespace(cache_path=str(tmp_path))))
    assert not functions.is_compiled()
    index = tmp_path / "kernels.motion-324.py311.nbi"
    index.touch()
    changed = Path(functions.__file__).stat().st_mtime
    os.utime(index, (changed + written, changed + written))
    assert functions.is_compiled() is kept


def test_the_same_poses_are_sampled_by_compiled_code():
    robot = calib.load(EXAMPLES / "five_bar.yaml")
    sampled = []
    for item in (True, False):
        with compile_kinematics(item):
            sampled.append(robot.sample(200, seed=4))
    assert np.array_equal(*sampled)


FIRST_USE = """
import sys

import calib
from calib.core.robots.acceleration import compile_kinematics

robot = calib.load(sys.argv[1])
with compile_kinematics():
    robot.sample(200, seed=4)
"""


@pytest.mark.amount(0, 1)
def test_the_first_program_says_once_that_it_compiles(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    program = [sys.executable, "-c", FIRST_USE, EXAMPLES / "five_bar.yaml"]
    first, second = (subprocess.run(program, env=environment, capture_output=True, text=True, check=True) for _ in "12")
    assert first.stderr == "numba compiles the kinematics; this takes about 5 s, once for each version\n"
    assert second.stderr == ""

"""Robots as functions in numpy and C: the same poses as the engine's, the way back, NaN where loops do not close."""

import subprocess
import sys

import numpy as np
import pytest

import calib
from calib.core.robots.configurations import solve_configurations
from calib.core.robots.joint_errors import term_columns
from calib.core.robots.terms.term import Context
from calib.exporting.functions.c_text import c_name
from tests.exporting.function_robots import (
    ROBOTS,
    exported,
    functions_of,
    imported,
    near,
    poses_of_engine,
    shaken,
    some_commands,
    some_conditions,
)
from tests.small_robots import ARM_YAML, write_arm, write_parallelogram, write_pose_loop

N = {"six-axis arm, every term": 100, "example arm": 100}
"""Poses of each robot; of those with loops, 40: `tests/exporting/function_robots.py` looks at 10 000 of each."""
LANGUAGES = ("numpy", "c")
EACH = [(name, language) for name in ROBOTS for language in LANGUAGES]


class Case:
    """A robot, commands under all kinds of conditions, and what the engine says there."""

    def __init__(self, name, folder):
        self.robot, n = ROBOTS[name](folder), N.get(name, 40)
        self.folder = folder
        self.q, self.context = some_commands(self.robot, n), some_conditions(self.robot, n)
        self.truth = [poses_of_engine(self.robot, self.q, self.context, k) for k in range(len(self.robot.target_names))]
        self.functions = {}

    def of(self, language):
        """Its functions, called with commands, context and tool in either language."""
        if language not in self.functions:
            self.functions[language] = functions_of(self.robot, language, self.folder)
        return self.functions[language]


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    made = {}

    def of(name):
        if name not in made:
            made[name] = Case(name, tmp_path_factory.mktemp("robot"))
        return made[name]

    return of


@pytest.mark.quick(2)
@pytest.mark.parametrize(("name", "language"), EACH)
def test_poses_are_those_of_the_engine_and_open_loops_are_no_numbers(cases, name, language):
    case = cases(name)
    for tool, truth in enumerate(case.truth):
        poses = case.of(language).forward(case.q, case.context, tool)
        closed = np.isfinite(truth[:, 0, 0])
        assert np.array_equal(np.isfinite(poses).all(axis=(1, 2)), closed)
        assert np.array_equal(np.isnan(poses).all(axis=(1, 2)), ~closed)
        # where loops are nearly singular, rounding moves links far
        regular = closed & (distance(case) >= 0.1)
        assert regular.sum() > 0.3 * len(regular)
        assert np.abs(poses - truth)[regular].max() < 1e-12
        assert np.abs(poses - truth)[closed].max() < 1e-10


def distance(case):
    """From a singularity of the loops, of each pose."""
    columns = term_columns(case.robot, case.q, case.context)
    at = solve_configurations(case.robot, case.q, case.robot.close(case.q, columns=columns), columns)
    known = np.isfinite(at.slope).all(axis=(1, 2))
    values = np.zeros(len(known))
    if known.any():
        values[known] = calib.core.robots.closure.singular_values(case.robot.mechanism, at.slope[known])
    return values


@pytest.mark.quick(1)
@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize(
    "name", ["six-axis arm, every term", "MedRUE with a rail's terms", "Stewart platform, compliance"]
)
def test_the_jacobian_is_that_of_differences_of_the_engine(cases, name, language):
    case, step = cases(name), 1e-5
    some = np.flatnonzero(distance(case) >= 0.1)[:6]
    q, context, truth = case.q[some], case.context.select(some), case.truth[0][some]
    motion = case.of(language).jacobian(q, context)
    for j in range(q.shape[1]):
        moved = step * np.eye(q.shape[1])[j]
        ahead, behind = (poses_of_engine(case.robot, q + sign * moved, context) for sign in (1, -1))
        rate = (ahead - behind) / (2 * step)
        spin = rate[:, :3, :3] @ truth[:, :3, :3].swapaxes(1, 2)
        turning = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        # differences are off by step^2 times the third derivative, which teeth of 60 to a turn make large
        assert np.abs(motion[:, :, j] - np.hstack([rate[:, :3, 3], turning])).max() < 2e-7


@pytest.mark.quick(1)
@pytest.mark.parametrize(("name", "language"), EACH)
def test_commands_for_a_pose_lead_back_to_it(cases, name, language):
    case = cases(name)
    some = np.flatnonzero(distance(case) >= 0.1)[:25]
    lower, upper = case.robot.urdf.limits(case.robot.joint_names)
    some = some[((case.q[some] >= lower) & (case.q[some] <= upper)).all(axis=1)]
    goals, context = case.truth[0][some], case.context.select(some)
    q = case.of(language).inverse(goals, near(case.robot, case.q[some]), context)
    result = np.isfinite(q).all(axis=1)
    assert np.array_equal(np.isnan(q).all(axis=1), ~result)
    assert result.mean() > 0.9
    assert ((q[result] >= lower) & (q[result] <= upper)).all()
    there = poses_of_engine(case.robot, q[result], context.select(np.flatnonzero(result)))
    assert np.abs(there - goals[result]).max() < 2e-10


@pytest.mark.quick(0)
@pytest.mark.parametrize(("name", "language"), [("example arm", "numpy"), ("MedRUE with a rail's terms", "c")])
def test_what_is_found_from_home_is_found_from_every_start_and_nothing_else_is_told(cases, name, language):
    case = cases(name)
    lower, upper = case.robot.urdf.limits(case.robot.joint_names)
    some = np.flatnonzero(distance(case) >= 0.1)[:10]
    goals, context, n = case.truth[0][some].copy(), case.context.select(some), len(some)
    goals[0, 2, 3] += 10.0  # m: out of reach
    inverse, home = case.of(language).inverse, np.tile(case.robot.home, (n, 1))
    known = np.isfinite(inverse(goals, home, context)[:, 0])
    assert not known[0]
    assert known.mean() > 0.5  # the arm's joints turn less than once round
    starts = (case.robot.sample(n, 7), home + 10.0 * (upper - lower), np.full_like(home, np.nan))
    for start in starts:
        q = inverse(goals, start, context)
        told = np.isfinite(q).all(axis=1)
        assert told[known].all()
        assert not told[0]
        assert ((q[told] >= lower) & (q[told] <= upper)).all()
        there = poses_of_engine(case.robot, q[told], context.select(np.flatnonzero(told)))
        assert np.abs(there - goals[told]).max() < 2e-10


@pytest.mark.quick(0)
@pytest.mark.parametrize("language", LANGUAGES)
def test_only_what_is_asked_for_must_be_met(cases, language):
    """A five-bar reaches places in its plane, with the orientation that it happens to have there."""
    case = cases("five-bar")
    some = np.flatnonzero(distance(case) >= 0.1)[:6]
    goals, start = case.truth[0][some].copy(), near(case.robot, case.q[some])
    goals[:, :3, :3] = np.eye(3)
    goals[:, 2, 3] += 0.3
    functions, context = case.of(language), case.context.select(some)
    assert np.isnan(functions.inverse(goals, start, context)).all()
    q = functions.inverse(goals, start, context, use=(1, 1, 0, 0, 0, 0))
    reached = poses_of_engine(case.robot, q, context)[:, :2, 3]
    assert np.abs(reached - goals[:, :2, 3]).max() < 2e-10


@pytest.mark.parametrize("language", LANGUAGES)
def test_conditions_that_are_not_given_are_neutral(cases, language):
    case = cases("six-axis arm, every term")
    neutral = Context.neutral(5, 6)
    truth = poses_of_engine(case.robot, case.q[:5], neutral)
    functions = case.of(language)
    poses = functions.module.forward(case.q[:5]) if language == "numpy" else functions.forward(case.q[:5], neutral)
    assert np.abs(poses - truth).max() < 1e-12
    assert np.abs(truth - case.truth[0][:5]).max() > 1e-4  # and they matter


def test_batches_of_any_shape(cases):
    case = cases("Stewart platform")
    module, q = case.of("numpy").module, case.q[:6]
    poses = module.forward(q)
    assert np.array_equal(module.forward(q.reshape(2, 3, 6)).reshape(6, 4, 4), poses)
    # rounding of products of matrices depends on how many there are
    assert np.abs(module.forward(q[0]) - poses[0]).max() < 1e-14
    assert module.jacobian(q.reshape(2, 3, 6)).shape == (2, 3, 6, 6)
    assert module.inverse(poses.reshape(2, 3, 4, 4), q[0]).shape == (2, 3, 6)
    assert module.forward(q[:0]).shape == (0, 4, 4)


def test_a_command_that_is_no_number_is_no_pose_and_leaves_the_others_alone(cases):
    case = cases("Stewart platform")
    q = case.q[:3].copy()
    q[1, 2] = np.nan
    assert np.isnan(case.of("numpy").module.forward(q)).any(axis=(1, 2)).tolist() == [False, True, False]


def test_wrong_arguments_are_said(cases):
    module = cases("six-axis arm, every term").of("numpy").module
    with pytest.raises(ValueError, match="q has 5 columns; the robot has the joints j1, j2"):
        module.forward(np.zeros(5))
    with pytest.raises(TypeError, match=r"temprature: .* depend on approach, time, temperature, load"):
        module.forward(np.zeros(6), temprature=20.0)


@pytest.mark.parametrize("language", LANGUAGES)
def test_the_placement_of_the_base_is_stated(tmp_path, language):
    """Poses are in the measurement frame; BASE leads to the root link. By hand, from the arm's own numbers."""
    yaml = ARM_YAML.replace("{frame: ground}", "{frame: ground, xyz: [1, 2, 3], rpy: [0, 0, 90 deg]}")
    robot = calib.load(write_arm(tmp_path, yaml))
    functions = functions_of(robot, language, tmp_path)
    pose = functions.forward(np.array([[0.3, 0.2, 0.0]]), some_conditions(robot, 1))
    across = 0.02 * np.cos(0.75) + 0.01 * np.sin(0.75)
    along = 0.125 + 0.25 + 0.2 + 0.13
    turn = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    in_root = functions.base.reshape(4, 4) @ pose[0]
    assert np.abs(in_root[:2, 3] - turn @ [along, across]).max() < 1e-12
    assert np.abs(pose[0, :2, 3] - [1 - in_root[1, 3], 2 + in_root[0, 3]]).max() < 1e-12


def test_the_file_needs_nothing_but_its_library(tmp_path):
    robot = calib.load(write_arm(tmp_path))
    calib.export(robot, tmp_path / "arm.py", "numpy")
    check = (
        "import sys, arm\n"
        "assert not [name for name in sys.modules if name.split('.')[0] in ('calib', 'pinocchio', 'scipy')]\n"
        "print(arm.forward([0.0, 0.0, 0.0]).shape)"
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", check], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout == "(4, 4)\n"


def test_the_same_robot_gives_the_same_file_and_says_where_it_comes_from(tmp_path, run_calib):
    arm = write_arm(tmp_path)
    for name in ("one.py", "two.py"):
        assert run_calib("export", arm, "--format", "numpy", "--out", tmp_path / name).code == 0
    text = (tmp_path / "one.py").read_text()
    assert text == (tmp_path / "two.py").read_text()
    module = imported(tmp_path / "one.py")
    assert f"Made from {arm}." in module.__doc__
    assert "turn [rad], slide [m], wrist [rad]" in module.__doc__


def test_names_that_are_odd_in_c_compile(tmp_path):
    path = write_arm(tmp_path)
    odd = '2nd \\"arm\\" */ @\u00e9'.replace('\\"', "")
    text = (tmp_path / "arm.urdf").read_text().replace("small arm", odd)
    (tmp_path / "arm.urdf").write_text(text, encoding="utf-8")
    robot = calib.load(path)
    made = functions_of(robot, "c", tmp_path)
    assert made.prefix == c_name(robot.name) == "robot_2nd_arm"
    q = np.array([[0.3, 0.2, 0.1]])
    assert np.abs(made.forward(q, some_conditions(robot, 1)) - robot.forward(q)).max() < 1e-12


def test_a_limit_of_a_passive_joint_is_kept(tmp_path):
    path = write_parallelogram(tmp_path)
    text = (tmp_path / "parallelogram.urdf").read_text()
    limited = '<joint name="c" type="revolute"> <limit lower="1" upper="2.5" effort="1" velocity="1"/>'
    (tmp_path / "parallelogram.urdf").write_text(text.replace('<joint name="c" type="continuous">', limited))
    robot = calib.load(path)
    q = np.linspace(0.33, 2.83, 26)[:, None]  # and c is at q
    poses = exported(robot, "numpy", tmp_path).forward(q)
    inside = (q[:, 0] > 1) & (q[:, 0] < 2.5)
    assert np.array_equal(np.isfinite(poses[:, 0, 3]), inside)
    assert np.abs(poses[inside, :2, 3] - [0.5, 0] - 0.5 * np.column_stack([np.cos(q), np.sin(q)])[inside]).max() < 1e-12


def test_loops_of_whole_poses_are_refused(tmp_path, run_calib):
    done = run_calib("export", write_pose_loop(tmp_path), "--format", "c", "--out", tmp_path / "robot.h")
    assert done.code == 2
    assert done.err.startswith("calib: format 'c': loop tip_left-tip_right is of type 6d")
    assert not (tmp_path / "robot.h").exists()


def test_what_holds_everything_is_the_whole_fit(tmp_path):
    """Files of a fit with terms get these terms, and how good they are."""
    robot = calib.load(write_arm(tmp_path, ARM_YAML + "  - {joint: turn, term: gain, sigma: 3 mrad}\n"))
    data = calib.simulate(shaken(robot, part=1.0), robot.sample(60, 1), 1e-5, seed=2)
    fit = calib.fit(robot, data)
    calib.export(fit.robot, tmp_path / "fitted.py", "numpy")
    module, q = imported(tmp_path / "fitted.py"), data.joints[:10]
    assert np.abs(module.forward(q) - fit.robot.forward(q)).max() < 1e-12
    assert "error of the robot in this file: " in module.__doc__

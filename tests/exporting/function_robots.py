"""Exported functions of robots, held against the engine; the robots, and how their files are run here.

    python -m tests.exporting.function_robots [FOLDER]

prints, for each robot, how far the functions in numpy and C are from `calib` over 10 000 poses, whether they close the
same poses, how often they find the way back, and the time for one pose; with FOLDER also for the UR10 of the public
data (`tests/public_data.py`), fitted with `--terms auto`. It takes about five minutes.
"""

import argparse
import ctypes
import importlib.util
import re
import shutil
import subprocess
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.core.robots import kinematics
from calib.core.robots.closure import residual
from calib.core.robots.configurations import solve_configurations
from calib.core.robots.joint_errors import term_columns
from calib.core.robots.terms.term import Context
from calib.core.robots.terms.terms import parse_terms
from tests.project import EXAMPLES, ROOT
from tests.six_axis_arm import FREE, URDF, YAML

INERTIAL = (
    '<inertial><origin xyz="0.05 0.02 0.1"/><mass value="{mass}"/>'
    '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
)
EVERY_TERM = "gain,curve,backlash,drift,temperature,compliance,bending,gravity_backlash"
WARNINGS = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
_DOORS = """\
#include "robot.h"
size_t poses_of(size_t n, const double *q, const @_conditions *given, int tool, double *poses);
size_t poses_of(size_t n, const double *q, const @_conditions *given, int tool, double *poses) {
    return @_forward_many(n, q, given, tool, poses);
}
int motion_of(const double *q, const @_conditions *given, int tool, double *motion);
int motion_of(const double *q, const @_conditions *given, int tool, double *motion) {
    return @_jacobian(q, given, tool, motion);
}
int commands_of(const double *pose, const double *start, const @_conditions *given, const int *use, double *q);
int commands_of(const double *pose, const double *start, const @_conditions *given, const int *use, double *q) {
    return @_inverse(pose, start, given, 0, use, q);
}
const double *base_of(void);
const double *base_of(void) { return @_base(); }
"""


def with_masses(urdf):
    """A URDF whose links without a body of their own get one."""
    masses = iter(np.linspace(6.0, 0.5, urdf.count("<link")).round(3))
    return re.sub(
        r'<link name="([^"]+)"\s*/>',
        lambda link: f'<link name="{link[1]}">{INERTIAL.format(mass=next(masses))}</link>',
        urdf,
    )


def shaken(robot, seed=1, part=0.3):
    """A robot whose parameters are off as they are expected to be, times a part."""
    sigma = np.array([parameter.sigma_si for parameter in robot.parameters])
    return robot.with_parameters(robot.values + part * sigma * np.random.default_rng(seed).standard_normal(len(sigma)))


def six_axes(folder):
    """The six-axis arm with masses and every term: curves, backlash, a coupling, warming, compliance and bending."""
    (folder / "arm.urdf").write_text(with_masses(URDF))
    (folder / "arm.yaml").write_text(YAML + FREE + "  - {joint: j2, term: coupling, driven_by: j3}\n")
    robot = calib.load(folder / "arm.yaml")
    return shaken(robot.with_terms((*robot.description.terms, *parse_terms(EVERY_TERM))))


def stewart_with_masses(folder):
    """The Stewart platform, with legs that are compliant under its weight, and have gears."""
    (folder / "stewart.urdf").write_text(with_masses((EXAMPLES / "stewart.urdf").read_text()))
    shutil.copy(EXAMPLES / "stewart.yaml", folder)
    return shaken(calib.load(folder / "stewart.yaml").with_terms(parse_terms("gain,curve,compliance,backlash")))


ROBOTS = {
    "six-axis arm, every term": six_axes,
    "MedRUE with a rail's terms": lambda folder: shaken(calib.load(ROOT / "urdf" / "medrue_extended.yaml")),
    "Stewart platform": lambda folder: shaken(calib.load(EXAMPLES / "stewart.yaml")),
    "Stewart platform, compliance": stewart_with_masses,
    "delta robot": lambda folder: shaken(calib.load(EXAMPLES / "delta.yaml")),
    "five-bar": lambda folder: shaken(calib.load(EXAMPLES / "five_bar.yaml")),
    "example arm": lambda folder: shaken(calib.load(EXAMPLES / "arm.yaml")),
}


def some_commands(robot, n, seed=3):
    """Commands over the joint limits, of which a quarter need not close."""
    lower, upper = robot.urdf.limits(robot.joint_names)
    turn = np.pi * robot.mechanism.joint_scale
    q = np.random.default_rng(seed).uniform(np.maximum(lower, -turn), np.minimum(upper, turn), (n, len(turn)))
    if robot.mechanism.loops:
        q[: n - n // 4] = robot.sample(n - n // 4, seed)
    return q


def some_conditions(robot, n, seed=4):
    """Conditions of n commands that differ in everything."""
    rng = np.random.default_rng(seed)
    approach = rng.choice([-1.0, 0.0, 1.0], (n, len(robot.joint_names)))
    return Context(approach, rng.uniform(0, 7200, n), rng.uniform(-3, 8, n), rng.uniform(0, 5, n))


def poses_of_engine(robot, q, context, target=0, *, sharp=True):
    """What the engine says: poses of a target in the measurement frame, NaN where loops do not close, (n, 4, 4).

    It ends where loops are open by 1e-13 m, which turns links by up to some 1e-12; `sharp`: one more Newton step.
    """
    columns = term_columns(robot, q, context)
    closed = robot.close(q, columns=columns)
    at = solve_configurations(robot, q, replace(closed, passive=np.nan_to_num(closed.passive)), columns)
    passive = at.passive.copy()
    if robot.mechanism.loops and sharp:
        gap, slope, _ = residual(robot.mechanism, at.actuated, passive)
        passive[closed.ok] -= np.linalg.solve(slope[closed.ok], gap[closed.ok, :, None])[:, :, 0]
    pair = robot.mechanism.targets[target]
    joints = robot.mechanism.all_joints(at.actuated, passive)
    poses = kinematics.relative_pose(kinematics.sweep(robot.mechanism, joints, (pair,)), pair.a, pair.b)
    poses[~closed.ok] = np.nan
    return poses


def imported(path):
    """A Python file as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def exported(robot, language, folder):
    """The functions of a robot as a module of Python."""
    path = folder / f"robot_{language}.py"
    calib.export(robot, path, language)
    return imported(path)


def functions_of(robot, language, folder):
    """The functions of a robot in numpy or C, called alike with commands, context and tool."""
    if language == "numpy":
        return Numpy(exported(robot, language, folder))
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    calib.export(robot, folder / "robot.h", "c")
    return Compiled(robot, folder / "robot.h")


def by_name(functions, context):
    """Conditions as the functions of Python take them, those that they know."""
    told = {"approach": context.approach, "time": context.time, "load": context.load}
    told["temperature"] = context.temperature + 20.0
    return {name: told[name] for name in functions.CONDITIONS}


class Numpy:
    """A module of numpy."""

    def __init__(self, module):
        self.module, self.base = module, np.array(module.BASE)

    def forward(self, q, context, tool=0):
        return self.module.forward(q, tool, **by_name(self.module, context))

    def jacobian(self, q, context):
        return self.module.jacobian(q, **by_name(self.module, context))

    def inverse(self, poses, start, context, use=(1, 1, 1, 1, 1, 1)):
        return self.module.inverse(poses, start, use=use, **by_name(self.module, context))


class Compiled:
    """A file of C, compiled with all warnings."""

    def __init__(self, robot, path):
        self.n = len(robot.joint_names)
        self.prefix = re.search(r"int (\w+)_forward", path.read_text())[1]
        (path.parent / "doors.c").write_text(_DOORS.replace("@", self.prefix))
        command = ["cc", *WARNINGS, "-O2", "-fPIC", "-shared", "doors.c", "-o", "doors.so", "-lm"]
        subprocess.run(command, cwd=path.parent, check=True)
        self.compiled = ctypes.CDLL(str(path.parent / "doors.so"))
        self.compiled.base_of.restype = ctypes.POINTER(ctypes.c_double)
        self.base = np.ctypeslib.as_array(self.compiled.base_of(), (16,))

    def forward(self, q, context, tool=0):
        given, poses = self._given(context), np.empty((len(q), 4, 4))
        self.compiled.poses_of(ctypes.c_size_t(len(q)), _at(q), _at(given), tool, _at(poses))
        return poses

    def jacobian(self, q, context):
        given, motions = self._given(context), np.empty((len(q), 6, self.n))
        for row, given_row, motion in zip(np.ascontiguousarray(q), given, motions, strict=True):
            self.compiled.motion_of(_at(row), _at(given_row), 0, _at(motion))
        return motions

    def inverse(self, poses, start, context, use=(1, 1, 1, 1, 1, 1)):
        given, commands, use = self._given(context), np.empty((len(poses), self.n)), (ctypes.c_int * 6)(*use)
        poses, start = np.ascontiguousarray(poses), np.ascontiguousarray(start)
        for pose, given_row, here, q in zip(poses, given, start, commands, strict=True):
            self.compiled.commands_of(_at(pose), _at(here), _at(given_row), use, _at(q))
        return commands

    def _given(self, context):
        columns = (context.approach, context.time, context.temperature + 20.0, context.load)
        return np.column_stack(columns)


def _at(array):
    assert array.flags.c_contiguous
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def near(robot, q, seed=6):
    """Starts near commands, inside the joint limits."""
    lower, upper = robot.urdf.limits(robot.joint_names)
    moved = 0.05 * robot.mechanism.joint_scale * np.random.default_rng(seed).uniform(-1, 1, q.shape)
    return np.clip(q + moved, lower, upper)


def _figures(name, robot, folder, n=10_000):
    q, context = some_commands(robot, n), some_conditions(robot, n)
    truth = poses_of_engine(robot, q, context, sharp=False)
    closed = np.isfinite(truth[:, 0, 0])
    timed = np.flatnonzero(closed)[:2000]
    started = time.perf_counter()
    poses_of_engine(robot, q[timed], context.select(timed), sharp=False)
    seconds = {"calib": time.perf_counter() - started}
    print(f"{name}: {closed.sum()} of {n} poses close")
    for language in ("numpy", "c"):
        functions, conditions = functions_of(robot, language, folder), context.select(timed)
        poses = functions.forward(q, context)
        started = time.perf_counter()
        functions.forward(q[timed], conditions)
        seconds[language] = time.perf_counter() - started
        same = np.array_equal(np.isfinite(poses[:, 0, 0]), closed)
        apart = np.nan_to_num(np.abs(poses - truth))
        some = np.flatnonzero(closed)[:500]
        back = functions.inverse(poses[some], near(robot, q[some]), context.select(some))
        there = functions.forward(back, context.select(some))
        solved = np.isfinite(back[:, 0])
        missed = np.abs(there - poses[some])[solved].max()
        print(
            f"  {language:5}  closes the same: {same}; position {apart[:, :3, 3].max():.1e} m, rotation"
            f" {apart[:, :3, :3].max():.1e}; back: {solved.sum()} of {len(some)}, to {missed:.1e}"
        )
    print("  us for a pose: " + ", ".join(f"{key} {value / len(timed) * 1e6:.1f}" for key, value in seconds.items()))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", metavar="FOLDER", type=Path, nargs="?", help="public data; none: no UR10")
    options = parser.parse_args()
    for title, make in ROBOTS.items():
        with tempfile.TemporaryDirectory() as place:
            _figures(title, make(Path(place)), Path(place))
    if options.folder is not None:
        from tests.public_data import ur10_tracker

        arm, data, use = ur10_tracker(options.folder / "ur10_tracker")
        fitted = calib.fit(arm, data[use == "train"], terms="auto", validation=data[use == "test"])
        with tempfile.TemporaryDirectory() as place:
            _figures("UR10, fitted with its terms", fitted.robot, Path(place))

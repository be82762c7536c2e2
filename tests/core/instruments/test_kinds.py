"""What every kind of measurement keeps: exact derivatives, alone and through the chain of a robot, loops or none."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.core.instruments.kind import Readings, View
from calib.core.rows.observed import predict_readings
from medrue import robot_file
from medrue.paper_tables import table1
from medrue.workspace import target_workspace
from tests.core.instruments.test_kind_pixel import INTRINSICS, POINTS
from tests.core.instruments.test_kind_touch import EVERY as TOUCHED
from tests.kind_checks import chain_error, kind_error
from tests.project import EXAMPLES, copied
from tests.six_axis_arm import joints, write_six_axis

LENS = "{fx: 20, fy: 20, cx: 20, cy: 20, k1: 0.1, k2: 0.1, p1: 0.01, p2: 0.01, k3: 0.1}"
EYE = f"kind: pixel, intrinsics: {INTRINSICS}, unknown_intrinsics: {LENS}"
INSTRUMENTS = {
    "tracker": "{kind: pose, target: cell}",
    "turned": "{kind: orientation, target: cell}",
    "level": "{kind: orientation, target: cell, axes: gravity}",
    "gauge": "{kind: distance, target: ball, end: {frame: ROOT, xyz: [0.3, -0.9, 0.1]}, offset: 12 mm}",
    "beam": "{kind: distance, target: ball, end: {frame: ROOT, xyz: [0.9, 1, -0.4], position: unknown},"
    " offset: {value: 12 mm, sigma: 1 mm}}",
    "wire": "{kind: distance, target: ball, end: {frame: ROOT, position: unknown}, offset: unknown}",
    "eye": f"{{{EYE}, target: body, camera: {{frame: ROOT, xyz: [0, 0, 4], rpy: [180 deg, 0, 0]}}, points: {POINTS}}}",
    "own_eye": f"{{{EYE}, target: board, camera: {{frame: TIP, rpy: [0, 0.3, 0]}}, points: {POINTS}}}",
    "encoder": "{kind: joint_reading, joint: JOINT, zero: unknown}",
}
for form, words in TOUCHED.items():
    there = words.replace("l0", "ROOT").replace("left:", f"{form}_left:").replace("right:", f"{form}_right:")
    INSTRUMENTS[f"probe_{form.replace(' ', '_')}"] = f"{{kind: touch, target: ball, {there}}}"
TARGETS = """\
  ball: {frame: TIP, xyz: [50 mm, 20 mm, 100 mm], position: unknown}
  cell: {frame: TIP, orientation: unknown, position: unknown}
  body: {frame: TIP, position: unknown, orientation: unknown}
  board: {frame: ROOT, xyz: [0.3, 0.2, 2.5], position: unknown, orientation: unknown}
"""
WITH_LOOPS = ("tracker", "level", "wire", "eye", "encoder", "probe_planes")
"""Kinds of every sort: what moves a reading goes through the loops in the same way for all."""


def texts(names, root, tip, joint):
    """Targets and instruments of a description, on these links and this joint."""
    instruments = "".join(f"  {name}: {INSTRUMENTS[name]}\n" for name in names)
    result = (TARGETS, f"instruments:\n{instruments}")
    return [text.replace("ROOT", root).replace("TIP", tip).replace("JOINT", joint) for text in result]


def arm(folder):
    targets, instruments = texts(INSTRUMENTS, "l0", "l6", "j3")
    yaml = "urdf: arm.urdf\nname_mot: [j1, j2, j3, j4, j5, j6]\nbase: {frame: l0}\npriors: false\ntargets:\n"
    free = (
        "parametrisation:\n  - {origin: j2, components: [x, z], sigma: 2 mm}\n"
        "  - {origin: j5, components: [rx, ry], sigma: 5 mrad}\n"
    )
    return calib.load(write_six_axis(folder, yaml + targets + instruments + free)), 0.4 * joints(4)


def five_bar(folder):
    targets, instruments = texts(WITH_LOOPS, "table", "left_tip", "left_elbow")
    edits = ("sigma: 0.02 mm", instruments), ("targets:\n", f"targets:\n{targets}")
    robot = calib.load(copied(folder, EXAMPLES / "five_bar.yaml", *edits))
    return robot, robot.home + np.random.default_rng(5).uniform(-0.3, 0.3, (4, 2))


def medrue(folder):
    frame = calib.load(robot_file()).description.targets["tool"].frame
    targets, instruments = texts(("tracker", "wire", "encoder"), "world", frame, "B1")
    targets = re.sub(r", (position|orientation): unknown", "", targets)  # its parameters have the tool's place
    edits = ("sigma: 0.04 mm", instruments), ("targets:\n", f"targets:\n{targets}")
    robot = calib.load(copied(folder, robot_file(), *edits))
    actual = dict(zip(table1().names, table1().actual, strict=True))
    return robot.with_parameters(actual), np.array(target_workspace().q)[::210]


@pytest.mark.quick(0)
@pytest.mark.parametrize("made", [arm, five_bar, medrue], ids=lambda made: made.__name__)
def test_all_parameters_move_readings_of_every_kind_as_differences_say(tmp_path, made):
    """Beside the readings, not at them: readings are those of a robot that is a little off."""
    robot, q = made(tmp_path)
    other = robot.with_parameters(robot.values + np.random.default_rng(2).normal(0, 1e-4, len(robot.values)))
    readings = {}
    for name, read in predict_readings(other, other.assemble(q)).items():
        seen = np.flatnonzero(np.isfinite(read.values).all(axis=1))[:12]
        assert len(seen) > 1, name
        parts = (read.visits, read.pairs, read.values)
        readings[name] = Readings(*(part[seen] for part in parts), None, read.details[seen])
    assert len(readings) == len(robot.instruments)
    assert chain_error(robot, q, readings) <= 1e-6


@pytest.fixture(scope="module")
def instruments(tmp_path_factory):
    return arm(tmp_path_factory.mktemp("arm"))[0]


@pytest.mark.parametrize("name", [name for name in INSTRUMENTS if name != "encoder"])
def test_a_kind_by_itself_has_exact_derivatives(instruments, name):
    """At readings that are far from what is predicted."""
    instrument, rng = instruments.instrument(name), np.random.default_rng(3)
    pairs, details = (np.tile(part, (10, 1) if part.ndim > 1 else 10)[:30] for part in instrument.looks())
    n = len(pairs)
    places = np.column_stack([rng.uniform(-0.4, 0.4, (n, 2)), rng.uniform(1, 2, n)])  # before a camera
    view = View(Rotation.random(n, rng).as_matrix(), places)
    unknowns = np.array([unknown.nominal_si + 0.1 * unknown.sigma_si for unknown in instrument.unknowns])
    unknowns[~np.isfinite(unknowns)] = 0.02
    values = instrument.with_errors(
        instrument.predict(view, unknowns, details), rng.normal(0, 0.1, (n, instrument.n_rows))
    )
    readings = Readings(np.arange(n), pairs, values, None, details)
    assert kind_error(instrument, view, unknowns, readings) <= 1e-6

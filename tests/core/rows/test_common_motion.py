"""Readings tell which places of base and tools are unknown, and robots are compared without them."""

import numpy as np
import pytest

import calib
from calib.core.rows.common_motion import CommonMotion, UnknownPlaces
from tests.programs.compensated_robots import described
from tests.six_axis_arm import write_six_axis

ELSEWHERE = {"base.x": 2.1, "base.y": -0.3, "base.rz": 2.0, "base.rx": 0.1}
ARM = """\
urdf: arm.urdf
name_mot: [j1, j2, j3, j4, j5, j6]
base: {frame: l0, pose: BASE}
targets: {ball: {frame: l6, xyz: [50 mm, 20 mm, 100 mm], position: TOOL}}
parametrisation: [{origin: all, components: [x, y, z], sigma: 1 mm}]
"""
HOLE = "{frame: l0, xyz: [0.5, 0, 0.3], position: P}"
SOCKET = f"instruments: {{probe: {{kind: touch, target: ball, places: {{hole: {HOLE}}}}}}}\n"
SIX = "instruments: {six: {kind: pose, target: ball}}\n"
WIRE = "instruments: {wire: {kind: distance, target: ball, end: {frame: l0, xyz: [1, 0.5, 0.2], position: P}}}\n"


def arm(folder, base="unknown", tool="unknown", extra=""):
    return calib.load(write_six_axis(folder, ARM.replace("BASE", base).replace("TOOL", tool) + extra))


def test_a_platform_that_never_turns_does_not_tell_base_and_tool_apart(tmp_path):
    nominal = described("delta", tmp_path, "unknown")
    joints = nominal.sample(30, seed=0)
    tracked = nominal.with_parameters(ELSEWHERE)
    motion = CommonMotion.from_robots(nominal, tracked, UnknownPlaces.from_robot(nominal), joints)
    assert motion.loose == UnknownPlaces(True, (0,), (0,), ())
    assert motion.basis.shape == (9, 6)
    assert np.abs(motion.robot.positions(joints) - tracked.positions(joints)).max() < 1e-9


@pytest.mark.parametrize(
    ("base", "tool", "extra", "loose"),
    [
        ("unknown", "unknown", "", UnknownPlaces(True, (0,), (0,), ())),
        ("unknown", "known", "", UnknownPlaces(True, (0,), (), ())),
        ("known", "unknown", "", UnknownPlaces(False, (0,), (0,), ())),
        ("known", "known", "", UnknownPlaces(False, (0,), (), ())),
        ("unknown", "known", f"held: [{', '.join(f'base.{axis}' for axis in ('x', 'y', 'z', 'rx', 'ry', 'rz'))}]\n",
         UnknownPlaces(False, (0,), (), ())),
        ("known", "known", SOCKET.replace("P", "unknown"), UnknownPlaces(True, (0,), (), ())),
        ("known", "known", SOCKET.replace("P", "known"), UnknownPlaces(False, (0,), (), ())),
        ("unknown", "known", SOCKET.replace("P", "known"), UnknownPlaces(False, (0,), (), ())),
        ("known", "known", WIRE.replace("P", "unknown"), UnknownPlaces(True, (0,), (), ())),
        ("known", "known", "instruments: {level: {kind: orientation, target: ball, axes: gravity}}\n",
         UnknownPlaces(True, (0,), (), ())),
        ("unknown", "unknown, orientation: unknown", SIX,
         UnknownPlaces(True, (0,), (0,), (0,))),
    ],
)  # fmt: skip
def test_what_was_measured_in_a_known_frame_is_not_laid(tmp_path, base, tool, extra, loose):
    assert UnknownPlaces.from_robot(arm(tmp_path, base, tool, extra)) == loose

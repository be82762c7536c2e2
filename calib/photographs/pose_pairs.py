"""Hand-eye calibration from pairs of poses: a marker in the camera, and the tool in the base, at the same moments.

The pairs are fitted as readings of `kind: pose` of a robot. It slides along x, y, z and turns about x, y, z without
errors of its own, and the tool's poses are its joint values. The camera is the unknown base of its measurements, and
the marker its target:

    camera on the tool        A_i = C^-1 L_i^-1 M        camera fixed to the tool, marker to the base     (AX = XB)
    camera beside the robot   A_i = C^-1 L_i M           camera fixed to the base, marker to the tool     (AX = YB)

with A_i the marker in the camera and L_i the tool in the base. Closed forms (`calib.core.instruments.hand_eye`) decide
the mount, and whether poses were written inverted. The fit is least squares, with the noise of positions and of angles
from the residuals.

When it fails. If the tool turns only about parallel axes, heights along them stay open: undetermined components are
NaN, and the changes that no pair shows are named. Intervals contain the robot's own errors as far as residuals show
them, but not the part that moves camera and marker equally in all poses.

Reference: daniilidis1999.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import BoolArray, FloatArray, ReadOnlyArrays
from calib.core.base.contributions import Contributions, Uncertainty
from calib.core.base.errors import DataError
from calib.core.base.sections import COMPONENTS
from calib.core.base.units import in_unit, millimetres, quantity_text
from calib.core.calibrating.calibrate import calibrate
from calib.core.data.in_memory import as_measurements
from calib.core.fitting.settings import Settings
from calib.core.instruments.hand_eye import solve_poses
from calib.core.instruments.rotations import rotation_vectors
from calib.core.judging.reasons import Code
from calib.core.judging.verdict import JudgedFit
from calib.core.numerics.identifiability import eliminate, reduce_rows
from calib.core.robots.description import validate_description
from calib.core.robots.loading import build
from calib.core.robots.robot import Robot
from calib.core.robots.urdf.text import parse_urdf
from calib.core.rows.determination import determination
from calib.core.rows.observed import observe
from calib.core.rows.unknowns import Unknowns
from calib.photographs.hand_eye_result import FEW, WIDE, Frames, HandEyeJudgement, contents, transform
from calib.photographs.scene import OTHER, SIDES, Mount
from calib.shared.null_space import null_groups

LEAST_PAIRS = 3
_MUCH_BETTER = 3.0  # inverted poses are the right ones if residuals are more than this many times smaller with them
_OPEN = 0.05  # a component is undetermined if an unseen change moves it by more than this part of its largest one
_NAMED = 1e-3  # components of such a change that are smaller than this part of its largest one are not named
_STEP = 1e-6  # step of parameters for differences [m or rad]
_LINKS = ("base", "along_x", "along_y", "along_z", "about_x", "about_y", "tool")
_OF_JOINTS = {
    Code.JOINT_NEVER_MOVED, Code.JOINT_MOVED_LITTLE, Code.JOINTS_MOVE_TOGETHER, Code.JOINT_SCALED, Code.ONE_CORNER,
    Code.BEYOND_JOINT_LIMITS, Code.TURNS_NOT_COUNTED, Code.NO_GAIN, Code.NOTHING_TO_CORRECT, Code.MOVES_AS_ONE,
    Code.BASE_ELSEWHERE, Code.TARGET_ELSEWHERE,
}  # fmt: skip
"""Codes about a real robot's joints or earlier description, which do not apply here."""


@dataclass(frozen=True, eq=False)
class FoundPose(ReadOnlyArrays):
    """Pose of camera or marker.

    Attributes:
        pose: Pose in its parent frame, (4, 4) [m]; `open` marks undetermined components.
        half: Half widths of 95 % intervals: along x, y, z of that frame, and about the own x, y, z, (6,) [m, rad].
        open: Mask of undetermined components, (6,).
    """

    pose: FloatArray
    half: FloatArray
    open: BoolArray


@dataclass(frozen=True, eq=False)
class PosePairs(ReadOnlyArrays):
    """A hand-eye calibration from pairs of poses.

    Attributes:
        names: Names of the pairs.
        mount: Mount of the camera.
        camera, marker: Their poses.
        unseen: Changes that no pair shows, in words.
        errors: Predicted minus measured: position and rotation of the marker in the camera, (n, 6) [m, rad].
        reasons: Reasons against the result, each with its grade.
        distance: Mean distance from camera to marker [m].
        contains: Contributions to the intervals.
    """

    names: tuple[str, ...]
    mount: Mount
    camera: FoundPose
    marker: FoundPose
    unseen: tuple[str, ...]
    errors: FloatArray
    reasons: tuple[tuple[str, str], ...]
    distance: float
    contains: dict[Uncertainty, Contributions]


def solve_pairs(
    names: Sequence[str], tool: FloatArray, seen: FloatArray, mounts: tuple[Mount, ...] = ("tool", "base")
) -> PosePairs:
    """Return the poses of camera and marker, from the tool in the base and the marker seen, (n, 4, 4) [m] each.

    Raises:
        DataError: Too few pairs, or equal poses of the tool in all.
        CalibrationError: The fit fails.
    """
    if len(names) < LEAST_PAIRS:
        raise DataError(f"{len(names)} pairs of poses; give at least {LEAST_PAIRS}, better 10 to 20")
    if np.ptp(tool, axis=0).max() < _STEP:
        raise DataError("the tool has one pose in all pairs; give pairs at different poses")
    closed = {mount: _closed_form(tool, seen, mount) for mount in mounts}
    left = {mount: residual for mount, (residual, *_) in closed.items()}
    mount = min(left, key=lambda each: left[each])
    inverted = min(_closed_form(tool, np.linalg.inv(seen), each)[0] for each in mounts)
    reasons = []
    if inverted * _MUCH_BETTER < left[mount]:
        reasons.append(
            ("FAIL", "probable mistake: these are poses of the camera in the marker; their inverses fit far better")
        )
    if len(left) > 1 and max(left.values()) < _MUCH_BETTER * left[mount]:
        reasons.append(
            ("CHECK", f"a camera {SIDES[OTHER[mount]]} fits almost as well; say where it is with --camera-on")
        )
    robot = _robot(mount, *closed[mount][1:])
    angles = [-pin.rpy.matrixToRpy(turn.T) for turn in tool[:, :3, :3]]  # of hinges about x, the new y, the newest z
    joints = np.hstack([tool[:, :3, 3], angles])
    values = np.hstack([seen[:, :3, 3], rotation_vectors(seen[:, :3, :3])])
    data = as_measurements(robot, joints, {"camera": values}, list(names))
    observed = observe(robot, robot.assemble(data.joints, labels=data.labels), data.readings)["camera"]
    rows = observed.jacobian.reshape(-1, len(robot.parameters))
    found = determination(reduce_rows(rows), robot.parameters, robot.is_free)
    dropped = eliminate(found.columns).dropped
    scales = Unknowns.from_robot(robot, np.ones(len(robot.parameters), dtype=bool)).scales
    groups = null_groups(found.columns, dropped, found.lengths * scales)
    fitted = calibrate(robot.fix([robot.parameters[k].name for k in dropped]), data, None, Settings())
    null = np.zeros((len(robot.parameters), len(groups)))
    for k, group in enumerate(groups):
        null[list(group.members), k] = group.coefficients * scales[list(group.members)]
    (camera, camera_moves), (marker, marker_moves) = (
        _found_pose(fitted, null, place) for place in ("camera", "marker")
    )
    reasons += [
        (reason.grade, reason.text.split("; --exclude-outliers")[0])
        for reason in fitted.verdict.reasons
        if reason.code not in _OF_JOINTS
    ]
    return PosePairs(
        tuple(names),
        mount,
        camera,
        marker,
        tuple(_change_in_words(change) for change in np.vstack([camera_moves, marker_moves]).T),
        np.asarray(fitted.identification.after["camera"]),
        tuple(reasons),
        float(np.mean(np.linalg.norm(seen[:, :3, 3], axis=1))),
        {Uncertainty.POSITION: fitted.covariance.contains},
    )


def _closed_form(tool: FloatArray, seen: FloatArray, mount: Mount) -> tuple[float, FloatArray, FloatArray]:
    """RMS residual of the closed form, angles times the mean distance of the marker [m]; C and M, (4, 4) [m]."""
    links = tool if mount == "base" else np.linalg.inv(tool)
    camera, marker = solve_poses(links, seen, (np.eye(4), np.eye(4)), (False, False))
    off = np.linalg.inv(seen) @ np.linalg.inv(camera) @ links @ marker
    distance = np.mean(np.linalg.norm(seen[:, :3, 3], axis=1))
    turned = rotation_vectors(off[:, :3, :3])
    squares = np.sum(off[:, :3, 3] ** 2, axis=1) + distance**2 * np.sum(turned**2, axis=1)
    return float(np.sqrt(np.mean(squares))), camera, marker


def _robot(mount: Mount, C: FloatArray, M: FloatArray) -> Robot:
    """The robot that carries the tool, with camera and marker at C and M."""
    links, joints = [f'<link name="{name}"/>' for name in _LINKS], []
    for k, (parent, child) in enumerate(itertools.pairwise(_LINKS)):
        kind, axis = ("prismatic", "revolute")[k // 3], " ".join(str(float(k % 3 == axis)) for axis in range(3))
        joints.append(
            f'<joint name="tool_{"xyzabc"[k]}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<axis xyz="{axis}"/><limit lower="-1000" upper="1000" effort="0" velocity="0"/></joint>'
        )
    urdf = parse_urdf(f'<robot name="poses">{"".join(links + joints)}</robot>'.encode(), "the tool's poses")
    ends = ("tool", "base") if mount == "tool" else ("base", "tool")
    camera, marker = (
        {"frame": end, "xyz": pose[:3, 3].tolist(), "rpy": pin.rpy.matrixToRpy(pose[:3, :3]).tolist()}
        for end, pose in zip(ends, (np.linalg.inv(C), M), strict=True)
    )
    content = {
        "urdf": "poses",
        "name_mot": [joint.name for joint in urdf.joints],
        "base": camera | {"pose": "unknown"},
        "targets": {"marker": marker | {"position": "unknown", "orientation": "unknown"}},
        "instruments": {"camera": {"kind": "pose", "target": "marker"}},
        "parametrisation": [],
    }
    return build(validate_description(content, "pairs of poses"), urdf, "pairs of poses")


def _change_in_words(change: FloatArray) -> str:
    """A change of camera and marker, (12,) [m, rad], in words, scaled so that its largest part is 1 mm or 1 deg."""
    names = [f"{name} {part}" for name in ("camera", "marker") for part in COMPONENTS]
    units = 2 * (3 * ("mm",) + 3 * ("deg",))
    sizes = np.array([in_unit(value, unit) for value, unit in zip(change, units, strict=True)])
    named = zip(names, sizes / np.max(np.abs(sizes)), units, strict=True)
    return ", ".join(f"{name} {size:+.3g} {unit}" for name, size, unit in named if abs(size) > _NAMED)


def _found_pose(fitted: JudgedFit, null: FloatArray, place: str) -> tuple[FoundPose, FloatArray]:
    """Pose of `place` with its intervals, and its motion by unseen changes, (6, k)."""
    robot, pose = fitted.robot, _place(fitted.robot, place)

    def displace(step: FloatArray) -> FloatArray:
        after = _place(robot.with_parameters(robot.values + step), place)
        return np.append(after[:3, 3], rotation_vectors(pose[None, :3, :3].transpose(0, 2, 1) @ after[None, :3, :3]))

    steps = _STEP * np.eye(len(robot.parameters))
    by = np.stack([displace(step) - displace(-step) for step in steps], axis=1) / (2 * _STEP)  # (6, n_parameters)
    free = robot.is_free
    spread = by[:, free] @ np.asarray(fitted.covariance) @ by[:, free].T
    known = [fitted.parameters[name] for name in fitted.free_names]
    factor = max((float(each.half95_si) / each.std_si for each in known), default=float("nan"))
    half = factor * np.sqrt(np.diag(spread))
    unseen = by @ null
    return FoundPose(pose, half, np.any(np.abs(unseen) > _OPEN * np.max(np.abs(null), axis=0), axis=1)), unseen


def _place(robot: Robot, place: str) -> FloatArray:
    """Pose of camera or marker in its parent frame, (4, 4) [m]."""
    return np.asarray(robot.mechanism.placement("base" if place == "camera" else place).homogeneous)


def judge_pairs(result: PosePairs) -> HandEyeJudgement:
    """Return the judgement of a calibration: FAIL if the camera's pose is not determined or poses are misread."""
    reasons, advice = [*result.reasons], []
    for name, found in (("camera", result.camera), ("marker", result.marker)):
        lost = [COMPONENTS[k] for k in np.flatnonzero(found.open)]
        known = found.half[~found.open] / np.repeat([result.distance, 1.0], 3)[~found.open]
        if lost:
            grade = "FAIL" if name == "camera" else "CHECK"
            reasons.append(
                (grade, f"{', '.join(lost)} of the {name} {'is' if len(lost) == 1 else 'are'} not determined")
            )
            advice.append(
                "turn the tool about two axes or more; or measure by hand what is not determined, such as a height"
            )
        if not np.all(known < WIDE):
            reasons.append(("CHECK", f"the place of the {name} is poorly known: see its intervals"))
            advice.append("turn the tool further, about two axes or more, at more poses")
    if len(result.names) < FEW:
        reasons.append(("CHECK", f"{len(result.names)} pairs are few to judge by"))
        advice.append(f"take {FEW} to 20 pairs")
    return HandEyeJudgement.from_reasons(reasons, advice)


def report_pairs(result: PosePairs, frames: Frames) -> str:
    """Return the report of a calibration in words."""
    judgement, above = judge_pairs(result), frames.parents(result.mount)
    off, turned = (np.sqrt(np.mean(np.sum(part**2, axis=1))) for part in np.split(result.errors, 2, axis=1))
    lines = [
        f"Hand-eye calibration of {len(result.names)} pairs of poses: camera {SIDES[result.mount]}",
        *judgement.lines(),
        f"Residuals of the marker in the camera: {quantity_text(off, 'mm', '.3f')} and"
        f" {quantity_text(turned, 'mrad', '.3f')} RMS",
        _pose_in_words(f"Camera in {above[0]}", result.camera),
        _pose_in_words(f"Marker in {above[1]}", result.marker),
    ]
    lines += [
        f"These pairs cannot show a common change of {change}; measure one of them by hand" for change in result.unseen
    ]
    return "\n".join([*lines, *(f"Next: {text}" for text in judgement.advice)])


def _pose_in_words(title: str, found: FoundPose) -> str:
    parts = []
    pose = transform(found.pose)
    for k, name in enumerate("xyz"):
        text = f"{millimetres(pose[name]):.3f} ± {quantity_text(found.half[k], 'mm', '.3f')}"
        parts.append(f"{name} {'not determined' if found.open[k] else text}")
    about = [name for name, lost in zip("xyz", found.open[3:], strict=True) if lost]
    if about:
        return f"{title}: {', '.join(parts)}; its rotation about its {', '.join(about)} is not determined (95 %)"
    quaternion = " ".join(f"{pose[key]:.6f}" for key in ("qx", "qy", "qz", "qw"))
    halves = ", ".join(f"± {half:.3f}" for half in in_unit(found.half[3:], "deg"))
    return f"{title}: {', '.join(parts)}, quaternion (x y z w) {quaternion}, {halves} deg about its x, y, z (95 %)"


def content_of_pairs(result: PosePairs, frames: Frames) -> dict[str, object]:
    """Return a calibration as data [m, rad]; undetermined values are null."""
    above = frames.parents(result.mount)
    return {
        **judge_pairs(result).content(),
        "contains": contents(result.contains),
        "camera_on": result.mount,
        "camera": _as_data(above[0], frames.camera, result.camera),
        "board": _as_data(above[1], frames.board, result.marker),
        "not_determined": list(result.unseen),
        "pairs": [
            {"name": name, "position_m": error[:3].tolist(), "rotation_rad": error[3:].tolist()}
            for name, error in zip(result.names, result.errors, strict=True)
        ],
    }


def _as_data(parent: str, child: str, found: FoundPose) -> dict[str, object]:
    pose: dict[str, object] = dict(transform(found.pose))
    pose |= {name: None for name, lost in zip("xyz", found.open[:3], strict=True) if lost}
    if np.any(found.open[3:]):
        pose |= dict.fromkeys(("qx", "qy", "qz", "qw"))
    halves = [None if lost else float(half) for half, lost in zip(found.half, found.open, strict=True)]
    whole = {} if np.any(found.open) else {"matrix": found.pose.tolist()}
    return {
        "parent": parent,
        "child": child,
        **pose,
        **whole,
        "half_widths95": dict(zip(COMPONENTS, halves, strict=True)),
    }

"""The twin of a controller: joint origins with which a robot has the poses that its controller prints.

Order of work: (1) the meaning of the columns, and the places of base and tool (`calib.matching.readings`); (2) a fit of
all joint origins, with the covariance of rounding as the only noise; base and tool are where the user states, or at the
robot's own frames if they are near these: another base is equivalent to another first origin; what no pose shows of
both stays (`calib.matching.alignment`); (3) if more than rounding remains, another tool and pairs of another program
are tried, then joint terms, which a controller may have and a URDF cannot hold; (4) the claim
(`calib.matching.agreement`).

PASS means that rounding explains the residuals of all pairs, and that errors at other poses are of its size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError, InputError, NotIdentifiableError
from calib.core.base.units import millimetres
from calib.core.base.words import count_noun
from calib.core.calibrating.calibrate import calibrate
from calib.core.calibrating.file_robots import behind_last_axis
from calib.core.data.in_memory import as_measurements
from calib.core.data.measurements import Measurements
from calib.core.fitting.settings import Settings
from calib.core.instruments.kind import Readings
from calib.core.judging.verdict import JudgedFit
from calib.core.robots.description import validate_description
from calib.core.robots.jacobian import linearise
from calib.core.robots.loading import RobotLike, as_robot, build
from calib.core.robots.parametrisation import default_sections
from calib.core.robots.robot import Robot
from calib.matching.agreement import CONTROLLER, Agreement, agreement, explanation
from calib.matching.alignment import Alignment, align, distances, unseen_changes, without_unseen
from calib.matching.pairs import Pairs, read_pairs
from calib.matching.readings import PlacedInterpretation, alike_error, candidates, nominal_poses
from calib.matching.result import Match

_LEAST = 4  # pairs
_MOST = 500  # largest number of pairs in the fit
_NEAR = 0.015, np.radians(1.5)  # largest distance of base and tool from the robot's own frames [m], [rad]
_ELSEWHERE = 0.02, np.radians(2.0)  # misfit (RMS) that errors of the stock robot may add to a stated place [m], [rad]
_ALIKE = 2.0  # another reading fits as well if its residuals are less than this many times the best ones
_BETTER = 0.5  # the tool is another one if a free tool makes residuals less than this part
_WRONG = 0.2  # largest part of the pairs from another program
_SINGLE = 4.0  # least ratio of the worst pair's miss to the median if it is from another program


def match(
    robot: RobotLike,
    pairs: Path | str,
    *,
    tool: Sequence[float] | None = None,
    base: Sequence[float] | None = None,
    terms: bool = True,
    seed: int = 0,
) -> Match:
    """Find the joint origins with which a robot has the poses that its controller prints.

    Args:
        robot: The stock robot: description, URDF, or a calibration of Universal Robots.
        pairs: Joint values and poses (`calib.matching.pairs`).
        tool: Pose of the tool in the robot's last link, in the file's form; default: fitted.
        base: Pose of the robot's base in the controller's, in the file's form; default: fitted.
        terms: Whether to try joint terms if joint origins do not explain the poses.
        seed: Seed of the draws of rounding.

    Raises:
        DataError: Too few pairs; no reading of the columns fits, or several fit equally; a stated tool or base
            contradicts the pairs.
        InputError: The robot has loops.
    """
    nominal = as_robot(robot)
    if nominal.mechanism.loops:
        raise InputError(f"{nominal.path}: has loops; a controller's pairs are matched to chains of joints")
    read = read_pairs(pairs, nominal.joint_names)
    if len(read) < _LEAST:
        raise DataError(f"{pairs}: {count_noun(len(read), 'pair')}; at least {_LEAST} are needed, and 30 are good")
    remarks = [f"{_MOST} of {len(read)} pairs are used, evenly over the file"] * (len(read) > _MOST)
    read = read.evenly(_MOST)
    fits = [_first_fit(nominal, read, one, tool, base, seed) for one in candidates(nominal, read)]
    fit = _best_fit(fits, read) if len(fits) > 1 else fits[0]
    remarks += fit.candidate.reading.mistakes(read)
    if not fit.agreement.to_the_digits and fit.tool is not None:
        free = replace(fit, tool=None)
        if free.agreement.left_out < _BETTER * fit.agreement.left_out:
            remarks += ["the tool is another one than the one stated"] if tool is not None else []
            fit = free
    fit = _without_others(fit)
    tried = fit.explanation() if terms and not fit.agreement.to_the_digits else None
    away = _stock_misses(fit)
    gone = tuple((read.rows[k], float(away[k])) for k in range(len(away)) if k not in fit.kept)
    places = _places(fit, stated=(base is not None, tool is not None))
    stated = replace(fit, base=None if base is None else fit.base, tool=None if tool is None else fit.tool)
    remarks += [
        f"no pose shows the change {change}: both stay as near as possible; --base or --tool states one"
        for change in unseen_changes(stated.open_model())
    ]
    return Match(fit.fit, fit.candidate, read, fit.agreement, gone, places, tuple(remarks), tried)


def _first_fit(
    robot: Robot,
    pairs: Pairs,
    candidate: PlacedInterpretation,
    tool: Sequence[float] | None,
    base: Sequence[float] | None,
    seed: int,
) -> TwinFit:
    """The fit of a reading, with base and tool as stated, or at the robot's frames if they are near."""
    aligned = candidate.aligned
    q, printed = candidate.reading.values(pairs)
    links = nominal_poses(robot, q)
    given = {"base": base, "tool": tool}
    stated = {what: _pose(pose, what, pairs, candidate) for what, pose in given.items() if pose is not None}
    now = stated.get("base", np.eye(4)), stated.get("tool", np.eye(4))
    least = _misfit(aligned, candidate, links, printed)
    for names in (("tool",), ("base",), ("base", "tool")):
        if not stated.keys() >= set(names):
            continue
        aligned = align(links, printed, now, ("base" in names, "tool" in names))
        if np.any(_misfit(aligned, candidate, links, printed) - least > np.square(_ELSEWHERE)):
            nearest = align(links, printed, now)
            raise DataError(
                f"{pairs.path}: the poses contradict the stated {' and '.join(names)}: they give"
                f" {' and '.join(_place(getattr(nearest, what)) for what in names)}, and"
                f" {' and '.join(_place(stated[what]) for what in names)} was stated"
            )
    tool_place, base_place = (stated.get(what, _frame_near(getattr(aligned, what))) for what in ("tool", "base"))
    kept = tuple(int(k) for k in np.flatnonzero(candidate.aligned.kept))
    return TwinFit(robot, pairs, candidate, aligned, tool_place, base_place, kept, seed)


def _misfit(aligned: Alignment, candidate: PlacedInterpretation, links: FloatArray, printed: FloatArray) -> FloatArray:
    """Mean squared distance and turn of the pairs that are in the fit, (2,) [m^2, rad^2]."""
    apart = _twist(aligned.base @ links @ aligned.tool, printed)[candidate.aligned.kept].reshape(-1, 2, 3)
    return np.asarray(np.mean(np.sum(apart**2, axis=2), axis=0))


def _best_fit(fits: list[TwinFit], pairs: Pairs) -> TwinFit:
    """The reading that fits best; an error if another fits equally and no header decides."""
    best = min(fit.agreement.left_out for fit in fits)
    alike = [fit for fit in fits if fit.agreement.left_out <= _ALIKE * best]
    without_mistakes = [fit for fit in alike if not fit.candidate.reading.mistakes(pairs)]
    if len(alike) > 1 and (len(without_mistakes) != 1 or not pairs.words):
        raise alike_error(pairs, [fit.candidate.reading for fit in alike])
    return without_mistakes[0] if len(alike) > 1 else alike[0]


def _without_others(fit: TwinFit) -> TwinFit:
    """The fit without pairs of another program, if rounding explains the rest."""
    less = fit
    for _ in range(int(_WRONG * len(fit.pairs))):
        far = less.agreement.relative_distances
        if less.agreement.to_the_digits or len(far) <= _LEAST or np.max(far) < _SINGLE * np.median(far):
            break
        worst = less.kept[int(np.argmax(far))]
        less = replace(less, kept=tuple(k for k in less.kept if k != worst))
    return less if less.agreement.to_the_digits else fit


def _places(fit: TwinFit, stated: tuple[bool, bool]) -> tuple[str, str]:
    """Places of base and tool, in words."""
    description, name = fit.robot.description, fit.robot.target_names[0]
    texts = []
    for what, frame, known, given, place in (
        ("base", description.base.frame, fit.base, stated[0], "base"),
        ("tool", description.targets[name].frame, fit.tool, stated[1], name),
    ):
        if known is None:
            T = fit.found_place(place)
            texts.append(f"{what}: the controller's frame differs from {frame} by {_place(T)} (found; not in the URDF)")
        elif given:
            texts.append(f"{what}: as stated")
        else:
            turned = "" if np.allclose(known, np.eye(4)) else f", turned: {_place(known)}"
            texts.append(f"{what}: the controller's frame is {frame}{turned}")
    return texts[0], texts[1]


def _stock_misses(fit: TwinFit) -> FloatArray:
    """Distances of all pairs from the nominal robot with base and tool, (n,) [m]."""
    aligned = fit.candidate.aligned
    q, printed = fit.candidate.reading.values(fit.pairs)
    return distances(aligned.base @ nominal_poses(fit.robot, q) @ aligned.tool, printed)


def _pose(given: Sequence[float], what: str, pairs: Pairs, candidate: PlacedInterpretation) -> FloatArray:
    width = 3 + pairs.rotations.shape[1]
    if len(given) != width or not np.all(np.isfinite(given)):
        raise InputError(f"{what}: {count_noun(width, 'number')}, as the file writes a pose, not {len(given)}")
    numbers = np.array(given, dtype=float)[None]
    return replace(candidate.reading, direction="direct").poses(numbers[:, :3], numbers[:, 3:])[0]


def _frame_near(found: FloatArray) -> FloatArray | None:
    """The nearest frame turned by quarter turns, if `found` is near it; else None."""
    quarters = scipy.spatial.transform.Rotation.create_group("O").as_matrix()
    nearest = quarters[np.argmax(np.einsum("kij,ij->k", quarters, found[:3, :3]))]
    frame = np.eye(4)
    frame[:3, :3] = np.round(nearest)
    shift, turn = np.linalg.norm(_twist(frame[None], found[None])[0].reshape(2, 3), axis=1)
    return frame if shift <= _NEAR[0] and turn <= _NEAR[1] else None


def _place(pose: FloatArray) -> str:
    xyz = " ".join(f"{millimetres(float(x)):.3f}" for x in pose[:3, 3])
    rpy = " ".join(f"{a:.4f}" for a in scipy.spatial.transform.Rotation.from_matrix(pose[:3, :3]).as_euler("xyz", True))
    return f"xyz {xyz} mm, rpy {rpy} deg".replace(" -0.0000", " 0.0000").replace(" -0.000 ", " 0.000 ")


@dataclass(frozen=True, eq=False)
class TwinFit:
    """A reading of pairs with its fit.

    Attributes:
        robot: Nominal.
        pairs, candidate: The pairs, and the meaning of their columns.
        aligned: Base and tool from which the fit starts.
        tool, base: Known poses, (4, 4) [m]; None if the fit determines them.
        kept: Indices of the pairs in the fit.
        seed: Seed of the draws of rounding.
    """

    robot: Robot
    pairs: Pairs
    candidate: PlacedInterpretation
    aligned: Alignment
    tool: FloatArray | None
    base: FloatArray | None
    kept: tuple[int, ...]
    seed: int

    @cached_property
    def fit(self) -> JudgedFit:
        """The fit of joint origins."""
        return self._fit(self._data[0].joints)

    @cached_property
    def agreement(self) -> Agreement:
        """Agreement of the fit with the pairs."""
        return agreement(self.fit, self._data[1], self.seed)

    def explanation(self) -> tuple[str, Agreement]:
        """Return the joint terms of the controller, in words, and the agreement with them."""
        data, rounding = self._data
        return explanation(self.fit, self._fit, data.joints, rounding, self.seed)

    def _fit(self, joints: FloatArray) -> JudgedFit:
        try:
            return calibrate(self._model, replace(self._data[0], joints=joints), None, Settings(terms=None))
        except NotIdentifiableError:
            raise NotIdentifiableError(
                f"{self.pairs.path}: these pairs do not determine base and tool; add pairs in which all joints turn"
                " far, or state --base or --tool"
            ) from None

    def found_place(self, place: str) -> FloatArray:
        """Return the fitted pose of the target of this name, or of the base, (4, 4) [m]."""
        fit = self.fit
        mechanism = fit.robot.mechanism
        target = next((each for each in mechanism.targets if each.name == place), None)
        if target is not None:
            return np.asarray(mechanism.model.jointPlacements[target.b].homogeneous)
        base = fit.robot.description.base.frame
        return np.asarray(fit.robot.forward(np.zeros(len(fit.robot.joint_names)), base))

    @cached_property
    def _model(self) -> Robot:
        """The nominal robot with all joint origins free, and known or aligned base and tool.

        Fixed joints behind the last moving joint are a part of the tool, and stay, as does what no pose shows.
        """
        return without_unseen(self.open_model())

    def open_model(self) -> Robot:
        """Return the nominal robot with all joint origins free, and base and tool unless they are known."""
        robot, aligned, tool, base = self.robot, self.aligned, self.tool, self.base
        description, name = robot.description, robot.target_names[0]
        target, state = description.targets[name], "unknown" if tool is None else "known"
        placed = {"pose": "unknown" if base is None else "known", **_xyz_rpy(aligned.base if base is None else base)}
        held = _xyz_rpy(aligned.tool if tool is None else tool)
        content = {
            "urdf": Path(robot.urdf.path).name,
            "name_mot": robot.joint_names,
            "base": {"frame": description.base.frame, **placed},
            "targets": {name: {"frame": target.frame, "position": state, "orientation": state, **held}},
            "instruments": {CONTROLLER: {"kind": "pose", "target": name}},
            "parametrisation": default_sections(),
        }
        model = build(validate_description(content, robot.urdf.path), robot.urdf, robot.urdf.path)
        behind = behind_last_axis(model)
        return model.fix([p.name for p in model.parameters if p.name.rpartition(".")[0] in behind])

    @cached_property
    def _data(self) -> tuple[Measurements, FloatArray]:
        """The kept pairs with the covariance of rounding, and the effect of each rounded number, (n, 6, k)."""
        reading, pairs, model = self.candidate.reading, self.pairs, self._model
        kept = np.array(self.kept)
        joints, positions, rotations = (array[kept] for array in reading.select_pairs(pairs))
        q, T = reading.joints(joints), reading.poses(positions, rotations)
        n, n_joints = q.shape
        steps = reading.steps(pairs)
        by_joint = linearise(model, model.assemble(q), turns=True, joints=True).joint_derivative
        assert by_joint is not None
        columns = [
            np.einsum("vij,vj->vi", by_joint[:, 0], reading.joints(joints + steps[j] * np.eye(n_joints)[j]) - q)
            for j in range(n_joints)
        ]
        columns += [_twist(reading.poses(positions + steps[-2] * axis, rotations), T) for axis in np.eye(3)]
        axes = np.eye(rotations.shape[1])
        columns += [_twist(reading.poses(positions, rotations + steps[-1] * axis), T) for axis in axes]
        rounding = np.stack(columns, axis=2) / np.sqrt(12.0)
        covariance = rounding @ rounding.swapaxes(1, 2)
        values = np.hstack([T[:, :3, 3], scipy.spatial.transform.Rotation.from_matrix(T[:, :3, :3]).as_rotvec()])
        readings = Readings(np.arange(n), np.zeros(n, dtype=np.intp), values, covariance, np.zeros((n, 0)))
        names = [pairs.rows[k] for k in kept]
        return as_measurements(model, q, {CONTROLLER: readings}, names), rounding


def _xyz_rpy(pose: FloatArray) -> dict[str, list[float]]:
    rpy = scipy.spatial.transform.Rotation.from_matrix(pose[:3, :3]).as_euler("xyz")
    return {"xyz": pose[:3, 3].tolist(), "rpy": rpy.tolist()}


def _twist(moved: FloatArray, T: FloatArray) -> FloatArray:
    turn = scipy.spatial.transform.Rotation.from_matrix(moved[:, :3, :3] @ T[:, :3, :3].swapaxes(1, 2)).as_rotvec()
    return np.hstack([moved[:, :3, 3] - T[:, :3, 3], turn])

"""The twin of a controller: joint origins with which a robot has the poses that its controller prints.

Order of work: (1) what the columns mean, and where base and tool are (`calib.matching.readings`); (2) a fit of all
joint origins, with the covariance of rounding as the only noise; base and tool stand where the user says, or, if they
are near the robot's own frames, there: a base that differs is the same as another first origin; (3) where that leaves
more than rounding, another tool and pairs of another program are tried, then joint terms, which a controller may
compute with and a URDF cannot hold; (4) what it is worth (`calib.matching.agreement`).

PASS says that rounding explains the residuals of all pairs, and that what is left open at other poses is of its size.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import CalibrationError, DataError, InputError
from calib.core.base.files import write_files
from calib.core.base.units import error_scale, millimetres
from calib.core.base.words import as_data, counted, listed, plain_text
from calib.core.calibrating.calibrate import calibrate
from calib.core.data.in_memory import as_measurements
from calib.core.data.measurements import Measurements
from calib.core.fitting.settings import Settings
from calib.core.instruments.kind import Readings
from calib.core.judging.verdict import JudgedFit
from calib.core.results.results import save
from calib.core.robots.file_formats import formats, robot_for
from calib.core.robots.loading import RobotLike, as_robot
from calib.core.robots.loading import robot as robot_of
from calib.core.robots.parametrisation import default_sections
from calib.core.robots.robot import Robot
from calib.core.rows.jacobian import linearise
from calib.matching.agreement import Agreement, agreement
from calib.matching.alignment import Alignment, distances
from calib.matching.pairs import Pairs, read_pairs
from calib.matching.readings import Candidate, candidates, nominal_poses

CONTROLLER = "controller"
FILES = {"dh": "dh.csv", "mdh": "mdh.csv", "xacro": "origins.xacro", "ur-kinematics": "default_kinematics.yaml"}
"""What is written beside the URDF, by the format."""
_WIDTH = 118
_LEAST = 4  # pairs
_NEAR = 0.015, np.radians(1.5)  # of base and tool from frames of the robot, which are then taken for them [m], [rad]
_ELSEWHERE = 0.02, np.radians(2.0)  # of what is stated from what is found, beyond which it is wrong [m], [rad]
_ALIKE = 2.0  # residuals over those of the best reading, up to which another one fits alike
_BETTER = 0.5  # residuals with a free tool over those without, below which the tool is another one
_WRONG = 0.2  # part of the pairs that may be of another program
_SINGLE = 4.0  # distance of the worst pair from what the others predict, over the median, if it is of another program
_OF_DIGITS = 2.0  # claim over what rounding does to a printed position, up to which it is of its size


@dataclass(frozen=True)
class Match:
    """A robot matched to a controller.

    Attributes:
        fit: Joint origins, and base or tool where these were found.
        candidate: What the columns mean.
        pairs: The file.
        agreed: What the result is worth.
        left_out: Names of pairs that are of another program, and how far they are off [m].
        places: Where base and tool are, in words.
        remarks: What is not as its header, or the user, says.
        terms: Joint terms with which the controller would agree better, and what these leave; None if not tried.
    """

    fit: JudgedFit
    candidate: Candidate
    pairs: Pairs
    agreed: Agreement
    left_out: tuple[tuple[str, float], ...]
    places: tuple[str, ...]
    remarks: tuple[str, ...]
    terms: tuple[str, Agreement] | None

    @property
    def grade(self) -> Literal["PASS", "CHECK", "FAIL"]:
        """PASS, CHECK or FAIL."""
        if not self.agreed.to_the_digits:
            return "FAIL" if self.fit.verdict.grade == "FAIL" else "CHECK"
        return "CHECK" if self.left_out or self.agreed.claim > _OF_DIGITS * self.agreed.allowed else "PASS"

    @property
    def conclusion(self) -> str:
        """The answer in a sentence or two."""
        agreed = self.agreed
        if not agreed.to_the_digits:
            return (
                f"the controller knows something that joint origins cannot hold: pairs that were left out in turn are"
                f" {_mm(agreed.left_out)} off (RMS), where the file's digits allow {_mm(agreed.allowed)};"
                f" {self._terms_tried()}"
            )
        elsewhere = f"{_mm(agreed.claim)} and {_mrad(agreed.turn_claim)} at 95 % of all poses"
        said = f"agrees to {_mm(agreed.rms)} (RMS), which is what the file's digits allow; elsewhere within {elsewhere}"
        if agreed.claim > _OF_DIGITS * agreed.allowed:
            return f"{said}: these pairs leave some joints open; add pairs in which all joints turn far"
        return said

    def _terms_tried(self) -> str:
        if self.terms is None:
            return "joint terms were not tried"
        words, left = self.terms
        if not words:
            return "gravity, couplings, gears and other joint terms were tried, and none of them explains it"
        if left.to_the_digits:
            return f"with {words} it agrees to the digits; a URDF has no place for that"
        return f"with {words}, {_mm(left.left_out)} are left; a URDF has no place for that"

    def report(self) -> str:
        """Return the result as text."""
        before = self.candidate.aligned
        lines = [
            f"{counted(len(self.pairs), 'pair')} of {self.pairs.path}: {self.candidate.reading.words()}",
            *(f"note: {remark}" for remark in self.remarks),
            *self.places,
            f"stock model: {_mm(before.miss)} off (RMS, base and tool placed as well as possible)",
            *(f"{row} is of another program, tool or base: {_mm(away)} off; left out" for row, away in self.left_out),
            f"{self.grade}: {self.conclusion}",
        ]
        return plain_text([line[0].upper() + line[1:] for line in lines], _WIDTH, wrap=True).rstrip()

    def to_dict(self) -> dict[str, Any]:
        """Return the result for `--json` and match.json; lengths in mm, angles in mrad."""
        agreed = self.agreed
        numbers = {
            "rms": millimetres(agreed.rms),
            "left_out_in_turn": millimetres(agreed.left_out),
            "digits_allow": millimetres(agreed.allowed),
            "claim": millimetres(agreed.claim) if agreed.to_the_digits else None,
            "claim_angle": agreed.turn_claim * error_scale("angle") if agreed.to_the_digits else None,
        }
        return as_data(
            {
                "grade": self.grade,
                "conclusion": self.conclusion,
                "pairs": len(self.pairs),
                "reading": self.candidate.reading.words(),
                "remarks": self.remarks,
                "places": self.places,
                "stock_model": millimetres(self.candidate.aligned.miss),
                "other_program": [row for row, _ in self.left_out],
                **numbers,
            }
        )

    def save(self, folder: Path | str, *, force: bool = False) -> list[str]:
        """Write the result folder of the fit, and the robot in the formats that controllers and ROS hold.

        Args:
            folder: Where to.
            force: Whether files are replaced that this program did not write.

        Returns:
            The names of the robot's files.
        """
        save(self.fit, folder, force=force or (self.grade != "FAIL"))
        files = {Path(folder) / "match.json": (json.dumps(self.to_dict(), indent=1) + "\n").encode()}
        if self.grade != "FAIL" or force:
            for name, file in FILES.items():
                each = formats().get(name)
                if each is not None and each.write is not None and each.fits(self.fit.robot):
                    content = each.write(robot_for(self.fit.robot, name, force=True), [self.conclusion]).content
                    files[Path(folder) / file] = content
        write_files(files, force=force)
        return sorted(path.name for path in files) + ["calibrated.urdf"] * (Path(folder) / "calibrated.urdf").exists()


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
        tool: Pose of the tool in the robot's last link, as the file writes poses; found if not given.
        base: Pose of the robot's base in the controller's, likewise.
        terms: Whether joint terms are tried where joint origins do not explain the poses.
        seed: Of the draws of rounding.

    Raises:
        DataError: Too few pairs; no reading of the columns fits, or several do alike; a tool or base that was stated is
            another one.
        InputError: The robot has loops.
    """
    nominal = as_robot(robot)
    if nominal.mechanism.loops:
        raise InputError(f"{nominal.path}: has loops; a controller's pairs are matched to chains of joints")
    read = read_pairs(pairs, nominal.joint_names)
    if len(read) < _LEAST:
        raise DataError(f"{pairs}: {counted(len(read), 'pair')}; at least {_LEAST} are needed, and 30 are good")
    fitting = candidates(nominal, read)
    tried = [_Work.of(nominal, read, one, tool, base, seed) for one in fitting]
    if len(tried) > 1:
        tried = _decided(tried, nominal, read)
    return tried[0].matched(terms)


def _decided(tried: list[_Work], robot: Robot, pairs: Pairs) -> list[_Work]:
    """The reading that a fit prefers, first; an error where another one fits alike, and no header says which."""
    best = min(work.plain[1].left_out for work in tried)
    alike = [work for work in tried if work.plain[1].left_out <= _ALIKE * best]
    said = [work for work in alike if not work.candidate.reading.mistakes(robot, pairs)]
    if len(alike) > 1 and (len(said) != 1 or not pairs.words):
        words = " | ".join(work.candidate.reading.words() for work in alike)
        raise DataError(
            f"{pairs.path}: these readings of the columns fit alike: {words}; write units and the maker's words into"
            " the header (qw, W P R, A B C, [deg]), or add pairs in which the tool is turned more"
        )
    return said if len(alike) > 1 else alike


@dataclass(frozen=True, eq=False)
class _Work:
    """One reading on its way to a match: the fit with base and tool as stated, or at the robot's frames.

    Attributes:
        robot: Nominal.
        pairs, candidate, seed: What is matched.
        stated: Tool and base that the user stated, None where they did not, (4, 4) each.
        tool, base: As the fit knows them; None where it finds them.
        kept: Which pairs are used.
        plain: The fit, and its agreement.
    """

    robot: Robot
    pairs: Pairs
    candidate: Candidate
    seed: int
    stated: tuple[FloatArray | None, FloatArray | None]
    tool: FloatArray | None
    base: FloatArray | None
    kept: tuple[int, ...]
    plain: tuple[JudgedFit, Agreement]

    @classmethod
    def of(
        cls,
        robot: Robot,
        pairs: Pairs,
        candidate: Candidate,
        tool: Sequence[float] | None,
        base: Sequence[float] | None,
        seed: int,
    ) -> _Work:
        aligned = candidate.aligned
        stated = []
        for what, given, found in (("tool", tool, aligned.tool), ("base", base, aligned.base)):
            pose = None if given is None else _pose(given, what, pairs, candidate)
            if pose is not None and _beyond(pose, found, _ELSEWHERE):
                raise DataError(
                    f"{pairs.path}: the poses are of another {what} than the one stated: {_place(found)}, and not"
                    f" {_place(pose)}"
                )
            stated.append(pose)
        places = [
            given if given is not None else _frame_near(found)
            for given, found in zip(stated, (aligned.tool, aligned.base), strict=True)
        ]
        kept = tuple(int(k) for k in np.flatnonzero(aligned.kept))
        fitted = _fitted(robot, pairs, candidate, places[0], places[1], kept, seed)
        return cls(robot, pairs, candidate, seed, (stated[0], stated[1]), places[0], places[1], kept, fitted)

    def matched(self, terms: bool) -> Match:
        """Try what may explain what rounding does not, and say what was found."""
        work, remarks = self, [*self.candidate.reading.mistakes(self.robot, self.pairs)]
        if not work.plain[1].to_the_digits and work.tool is not None:
            free = work._again(tool=None)
            if free.plain[1].left_out < _BETTER * work.plain[1].left_out:
                if work.stated[0] is not None:
                    remarks.append("the tool is another one than the one stated")
                work = free
        work = work._without_others()
        tried = None
        if terms and not work.plain[1].to_the_digits:
            tried = work._with_terms()
        fit, agreed = work.plain
        rows = [k for k in range(len(self.candidate.aligned.misses)) if k not in work.kept]
        away = _stock_misses(work)
        gone = tuple((self.pairs.rows[k], float(away[k])) for k in rows)
        return Match(fit, self.candidate, self.pairs, agreed, gone, work._places(), tuple(remarks), tried)

    def _again(self, **changes: Any) -> _Work:
        work = replace(self, **changes)
        fitted = _fitted(work.robot, work.pairs, work.candidate, work.tool, work.base, work.kept, work.seed)
        return replace(work, plain=fitted)

    def _without_others(self) -> _Work:
        """Without pairs that are of another program, where rounding explains all others."""
        work = self
        for _ in range(int(_WRONG * len(self.pairs))):
            agreed = work.plain[1]
            one_is_off = np.max(agreed.far) > _SINGLE * np.median(agreed.far)
            if agreed.to_the_digits or len(work.kept) <= _LEAST or not one_is_off:
                break
            worst = work.kept[int(np.argmax(agreed.far))]
            work = work._again(kept=tuple(k for k in work.kept if k != worst))
        return work if work.plain[1].to_the_digits else self

    def _with_terms(self) -> tuple[str, Agreement] | None:
        try:
            fit, agreed = _fitted(
                self.robot, self.pairs, self.candidate, self.tool, self.base, self.kept, self.seed, "auto"
            )
        except CalibrationError:
            return None
        by_term: dict[str, list[str]] = {}
        for section in fit.robot.description.terms:
            by_term.setdefault(str(section.term), []).append(str(section.joint))
        words = listed([f"{term} of {listed(joints, shown=7)}" for term, joints in by_term.items()], " and ")
        return words, agreed

    def _places(self) -> tuple[str, str]:
        description, fit = self.robot.description, self.plain[0]
        tip = description.targets[self.robot.target_names[0]].frame
        said = []
        for what, frame, known, stated, place in (
            ("base", description.base.frame, self.base, self.stated[1], "base"),
            ("tool", tip, self.tool, self.stated[0], self.robot.target_names[0]),
        ):
            if stated is not None and known is not None:
                said.append(f"{what}: as stated")
            elif known is not None:
                turned = "" if np.allclose(known, np.eye(4)) else f", turned: {_place(known)}"
                said.append(f"{what}: the controller's is that of {frame}{turned}")
            else:
                T = _found(fit, place)
                said.append(f"{what}: the controller's differs from {frame}: {_place(T)} (found; not in the URDF)")
        return said[0], said[1]


def _stock_misses(work: _Work) -> FloatArray:
    """How far all pairs are from the nominal robot with base and tool, (n,) [m]."""
    reading, aligned = work.candidate.reading, work.candidate.aligned
    joints, positions, rotations = reading.paired(work.pairs)
    robot = aligned.base @ nominal_poses(work.robot, reading.joints(work.robot, joints)) @ aligned.tool
    return distances(robot, reading.poses(positions, rotations))


def _pose(given: Sequence[float], what: str, pairs: Pairs, candidate: Candidate) -> FloatArray:
    width = 3 + pairs.rotations.shape[1]
    if len(given) != width or not np.all(np.isfinite(given)):
        raise InputError(f"{what}: {counted(width, 'number')}, as the file writes a pose, not {len(given)}")
    numbers = np.array(given, dtype=float)[None]
    return replace(candidate.reading, direction="direct").poses(numbers[:, :3], numbers[:, 3:])[0]


def _beyond(pose: FloatArray, other: FloatArray, limits: tuple[float, float]) -> bool:
    turn = scipy.spatial.transform.Rotation.from_matrix(pose[:3, :3].T @ other[:3, :3]).magnitude()
    return bool(np.linalg.norm(pose[:3, 3] - other[:3, 3]) > limits[0] or turn > limits[1])


def _frame_near(found: FloatArray) -> FloatArray | None:
    """The frame itself, turned by quarter turns, if what was found is near it; else None."""
    quarters = scipy.spatial.transform.Rotation.create_group("O").as_matrix()
    nearest = quarters[np.argmax(np.einsum("kij,ij->k", quarters, found[:3, :3]))]
    frame = np.eye(4)
    frame[:3, :3] = np.round(nearest)
    return None if _beyond(frame, found, _NEAR) else frame


def _place(pose: FloatArray) -> str:
    xyz = " ".join(f"{millimetres(float(x)):.3f}" for x in pose[:3, 3])
    rpy = " ".join(f"{a:.4f}" for a in scipy.spatial.transform.Rotation.from_matrix(pose[:3, :3]).as_euler("xyz", True))
    return f"xyz {xyz} mm, rpy {rpy} deg".replace(" -0.0000", " 0.0000").replace(" -0.000 ", " 0.000 ")


def _mm(length: float) -> str:
    return f"{millimetres(length):.2g} mm"


def _mrad(angle: float) -> str:
    return f"{angle * error_scale('angle'):.2g} mrad"


def _found(fit: JudgedFit, place: str) -> FloatArray:
    mechanism = fit.robot.mechanism
    target = next((each for each in mechanism.targets if each.name == place), None)
    if target is not None:
        return np.asarray(mechanism.model.jointPlacements[target.b].homogeneous)
    base = fit.robot.description.base.frame
    return np.asarray(fit.robot.forward(np.zeros(len(fit.robot.joint_names)), base))


def _fitted(
    robot: Robot,
    pairs: Pairs,
    candidate: Candidate,
    tool: FloatArray | None,
    base: FloatArray | None,
    kept: tuple[int, ...],
    seed: int,
    terms: str | None = None,
) -> tuple[JudgedFit, Agreement]:
    """Fit all joint origins to the pairs that are kept."""
    model = _model(robot, candidate.aligned, tool, base)
    data, rounding = _measured(model, pairs, candidate, np.array(kept))
    fit = calibrate(model, data, None, Settings(terms=terms))
    return fit, agreement(fit, CONTROLLER, rounding, seed)


def _model(robot: Robot, aligned: Alignment, tool: FloatArray | None, base: FloatArray | None) -> Robot:
    """The nominal robot with all joint origins free, and base and tool known, or where the alignment has them.

    Fixed joints behind the last that moves are a part of the tool, and stay.
    """
    description, name = robot.description, robot.target_names[0]
    target, state = description.targets[name], "unknown" if tool is None else "known"
    placed = {"pose": "unknown" if base is None else "known", **_xyz_rpy(aligned.base if base is None else base)}
    model = robot_of(
        robot.urdf.path,
        motors=robot.joint_names,
        base={"frame": description.base.frame, **placed},
        target={
            name: {
                "frame": target.frame,
                "position": state,
                "orientation": state,
                **_xyz_rpy(aligned.tool if tool is None else tool),
            }
        },
        instruments={CONTROLLER: {"kind": "pose", "target": name}},
        parametrisation=default_sections(),
    )
    parent = {joint.child: joint for joint in robot.urdf.joints}
    behind, link = [], target.frame
    while link in parent and parent[link].name not in robot.joint_names:
        behind.append(parent[link].name)
        link = parent[link].parent
    return model.fix([p.name for p in model.parameters if p.name.rpartition(".")[0] in behind])


def _xyz_rpy(pose: FloatArray) -> dict[str, list[float]]:
    rpy = scipy.spatial.transform.Rotation.from_matrix(pose[:3, :3]).as_euler("xyz")
    return {"xyz": pose[:3, 3].tolist(), "rpy": rpy.tolist()}


def _measured(
    model: Robot, pairs: Pairs, candidate: Candidate, kept: np.ndarray[Any, np.dtype[np.intp]]
) -> tuple[Measurements, FloatArray]:
    """The pairs that are kept, with the covariance of rounding, and what each rounded number does, (n, 6, k)."""
    reading = candidate.reading
    joints, positions, rotations = (array[kept] for array in reading.paired(pairs))
    q, T = reading.joints(model, joints), reading.poses(positions, rotations)
    n, n_joints = q.shape
    steps = reading.steps(model, pairs)
    by_joint = linearise(model, model.assemble(q), turns=True, joints=True).by_joint
    assert by_joint is not None
    columns = [
        np.einsum("vij,vj->vi", by_joint[:, 0], reading.joints(model, joints + steps[j] * np.eye(n_joints)[j]) - q)
        for j in range(n_joints)
    ]
    columns += [_twist(reading.poses(positions + steps[-2] * axis, rotations), T) for axis in np.eye(3)]
    axes = np.eye(rotations.shape[1])
    columns += [_twist(reading.poses(positions, rotations + steps[-1] * axis), T) for axis in axes]
    rounding = np.stack(columns, axis=2) / np.sqrt(12.0)
    covariance = rounding @ rounding.swapaxes(1, 2)
    values = np.hstack([T[:, :3, 3], scipy.spatial.transform.Rotation.from_matrix(T[:, :3, :3]).as_rotvec()])
    index = np.arange(n)
    readings = Readings(index, np.zeros(n, dtype=np.intp), values, covariance, np.zeros((n, 0)))
    names = [pairs.rows[k] for k in kept]
    return as_measurements(model, q, {CONTROLLER: readings}, names), rounding


def _twist(moved: FloatArray, T: FloatArray) -> FloatArray:
    turn = scipy.spatial.transform.Rotation.from_matrix(moved[:, :3, :3] @ T[:, :3, :3].swapaxes(1, 2)).as_rotvec()
    return np.hstack([moved[:, :3, 3] - T[:, :3, 3], turn])

"""The fit behind a match: joint origins, and unknown base or tool, with rounding as the only noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.calibrating.calibrate import calibrate
from calib.core.calibrating.file_robots import behind_last_axis
from calib.core.data.in_memory import as_measurements
from calib.core.data.measurements import Measurements
from calib.core.fitting.settings import Settings
from calib.core.instruments.kind import Readings
from calib.core.judging.verdict import JudgedFit
from calib.core.robots.description import validate_description
from calib.core.robots.jacobian import linearise
from calib.core.robots.loading import build
from calib.core.robots.parametrisation import default_sections
from calib.core.robots.robot import Robot
from calib.matching.agreement import Agreement, agreement, explanation
from calib.matching.pairs import Pairs
from calib.matching.readings import PlacedInterpretation

_CONTROLLER = "controller"  # name of its instrument


@dataclass(frozen=True, eq=False)
class TwinFit:
    """A reading of pairs with its fit.

    Attributes:
        robot: Nominal.
        pairs, candidate: The pairs, and the meaning of their columns.
        tool, base: Known poses, (4, 4) [m]; None if the fit determines them.
        kept: Indices of the pairs in the fit.
        seed: Seed of the draws of rounding.
    """

    robot: Robot
    pairs: Pairs
    candidate: PlacedInterpretation
    tool: FloatArray | None
    base: FloatArray | None
    kept: tuple[int, ...]
    seed: int

    @cached_property
    def _data(self) -> tuple[Measurements, FloatArray]:
        return self._measurements(self._model())

    @cached_property
    def fit(self) -> JudgedFit:
        """The fit of joint origins."""
        return self._fit(self._data[0].joints)

    @cached_property
    def agreement(self) -> Agreement:
        """Agreement of the fit with the pairs."""
        return agreement(self.fit, _CONTROLLER, self._data[1], self.seed)

    def explanation(self) -> tuple[str, Agreement]:
        """Return the joint terms of the controller, in words, and the agreement with them."""
        data, rounding = self._data
        return explanation(self.fit, self._fit, data.joints, _CONTROLLER, rounding, self.seed)

    def _fit(self, joints: FloatArray) -> JudgedFit:
        return calibrate(self._model(), replace(self._data[0], joints=joints), None, Settings(terms=None))

    def found_place(self, place: str) -> FloatArray:
        """Return the fitted pose of the target of this name, or of the base, (4, 4) [m]."""
        fit = self.fit
        mechanism = fit.robot.mechanism
        target = next((each for each in mechanism.targets if each.name == place), None)
        if target is not None:
            return np.asarray(mechanism.model.jointPlacements[target.b].homogeneous)
        base = fit.robot.description.base.frame
        return np.asarray(fit.robot.forward(np.zeros(len(fit.robot.joint_names)), base))

    def _model(self) -> Robot:
        """The nominal robot with all joint origins free, and known or aligned base and tool.

        Fixed joints behind the last moving joint are a part of the tool, and stay.
        """
        robot, aligned, tool, base = self.robot, self.candidate.aligned, self.tool, self.base
        description, name = robot.description, robot.target_names[0]
        target, state = description.targets[name], "unknown" if tool is None else "known"
        placed = {"pose": "unknown" if base is None else "known", **_xyz_rpy(aligned.base if base is None else base)}
        content = {
            "urdf": Path(robot.urdf.path).name,
            "name_mot": robot.joint_names,
            "base": {"frame": description.base.frame, **placed},
            "targets": {
                name: {
                    "frame": target.frame,
                    "position": state,
                    "orientation": state,
                    **_xyz_rpy(aligned.tool if tool is None else tool),
                }
            },
            "instruments": {_CONTROLLER: {"kind": "pose", "target": name}},
            "parametrisation": default_sections(),
        }
        model = build(validate_description(content, robot.urdf.path), robot.urdf, robot.urdf.path)
        behind = behind_last_axis(model)
        return model.fix([p.name for p in model.parameters if p.name.rpartition(".")[0] in behind])

    def _measurements(self, model: Robot) -> tuple[Measurements, FloatArray]:
        """The kept pairs with the covariance of rounding, and the effect of each rounded number, (n, 6, k)."""
        reading, pairs = self.candidate.reading, self.pairs
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
        index = np.arange(n)
        readings = Readings(index, np.zeros(n, dtype=np.intp), values, covariance, np.zeros((n, 0)))
        names = [pairs.rows[k] for k in kept]
        return as_measurements(model, q, {_CONTROLLER: readings}, names), rounding


def _xyz_rpy(pose: FloatArray) -> dict[str, list[float]]:
    rpy = scipy.spatial.transform.Rotation.from_matrix(pose[:3, :3]).as_euler("xyz")
    return {"xyz": pose[:3, 3].tolist(), "rpy": rpy.tolist()}


def _twist(moved: FloatArray, T: FloatArray) -> FloatArray:
    turn = scipy.spatial.transform.Rotation.from_matrix(moved[:, :3, :3] @ T[:, :3, :3].swapaxes(1, 2)).as_rotvec()
    return np.hstack([moved[:, :3, 3] - T[:, :3, 3], turn])

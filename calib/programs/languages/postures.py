"""Joint values for the poses of a program, on the branch of the inverse kinematics that the program means.

An arm reaches a pose in several ways. A program states the branch by quarter turns, signs or turns of its joints, or by
the side of axis 1 and of the arm on which the wrist is; if it states nothing, the previous pose decides. So each pose
is first solved from the previous one. If that solution is far away or contradicts the program, the solver starts from
many joint values and takes the solution that agrees with the program and is nearest to the previous pose.

Sides are relative to a reference pose: all joints at zero for ABB and KUKA, home for FANUC's N, U and T. The wrist is
the origin of axis 5. If the wrist axes of an arm do not meet, the side can be wrong near the border between two sides.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import InputError, nearest
from calib.core.robots.joint_sampling import joint_samples
from calib.core.robots.robot import Robot
from calib.programs.languages.robot_program import NO_SIDES, Configuration, FourSides
from calib.programs.reaching.goals import Goals
from calib.programs.reaching.inverse import problem
from calib.programs.reaching.reaching import GoalConfigurations, descend

_STARTS = (12, 64)
_FAR = 0.7  # distance of one joint from the pose before [rad]
_BORDER = 0.1  # tolerance of a stated joint range, since programs round its borders [rad]
_REACHED = 1e-8  # allowed error at a pose [m]
_ROUNDED = 2e-4  # allowed error of a robot with fewer than six motors at a rounded pose [m]
_ALIKE = 1e-9


class NominalCell:
    """A nominal robot with the base and flange links of its controller.

    Args:
        robot: The nominal robot.
        base, flange: Links of the controller; defaults as in `compensate_program`.

    Raises:
        InputError: No such link, or a link that moves against the description's base or target.
    """

    def __init__(self, robot: Robot, base: str | None = None, flange: str | None = None) -> None:
        self.robot, description, target = robot, robot.description, robot.mechanism.moved_targets[0].name
        self._lower, self._upper = (limit[: len(robot.home)] for limit in robot.urdf.limits(robot.mechanism.driven))
        self.base = self._link(base, "base", description.base.frame)
        self.flange = self._link(flange, "tool0", description.targets[target].frame)
        probes = np.array([robot.home, *self._probes(3)])
        probes = probes[robot.close(probes).ok]
        bases, flanges = (np.asarray(robot.forward(probes, link)) for link in (self.base, self.flange))
        between = np.linalg.inv(flanges) @ robot.forward(probes)
        for link, seen, what, option in (
            (self.base, bases, "the description's base", "--base-link"),
            (self.flange, between, f"target '{target}'", "--flange-link"),
        ):
            if np.max(np.abs(seen - seen[0])) > _ALIKE:
                raise InputError(
                    f"{robot.path}: link '{link}' moves relative to {what}; name another link with {option}"
                )
        self._base_pose, self._target = pin.SE3(bases[0]), pin.SE3(between[0])

    def _link(self, given: str | None, usual: str, otherwise: str) -> str:
        links = [*self.robot.urdf.links]
        if given is not None and given not in links:
            raise InputError(f"{self.robot.path}: no link '{given}'{nearest(given, links)}")
        return given or (usual if usual in links else otherwise)

    def _probes(self, count: int) -> FloatArray:
        """Joint values spread over the limits, at most half a turn from home, (count, n_actuated) [m or rad]."""
        lower = np.maximum(self._lower, self.robot.home - np.pi)
        upper = np.minimum(self._upper, self.robot.home + np.pi)
        return lower + (upper - lower) * joint_samples(self.robot.mode, count + 1)[1:, : len(lower)]

    def flange_poses(self, q: FloatArray) -> list[pin.SE3]:
        """Return T_base_flange at joints (n, n_actuated) [m or rad]."""
        return [self._base_pose.inverse() * pin.SE3(pose) for pose in np.asarray(self.robot.forward(q, self.flange))]

    def lever(self, tool: pin.SE3) -> float:
        """Return the distance of a tool's tip from the description's target [m]."""
        return float(np.linalg.norm(tool.translation - self._target.translation))

    def target_position(self, flange: pin.SE3) -> FloatArray:
        """Return the target's position in the base for a pose T_base_flange, (3,) [m]."""
        return np.asarray((flange * self._target).translation)

    def solve(
        self, flange: pin.SE3, before: FloatArray, says: Configuration | None, sides: Sides
    ) -> tuple[FloatArray | None, str]:
        """Return joints that bring the flange to T_base_flange, (n_actuated,) [m or rad], or None and the reason.

        They are near the joints of the pose before, (n_actuated,) [m or rad], in the configuration that the program
        states.
        """
        if says is not None and sides.are_undecided(says):
            return None, f"has configuration {says.text}, whose sides count from {sides.remedy}"
        goal = self._base_pose * flange * self._target
        goals = Goals(goal.translation[None], goal.rotation[None])
        q = self._nearest_solution(goals, before[None], before, says, sides)
        if q is None or np.max(np.abs(q - before)) > _FAR:
            for count in _STARTS:
                more = self._nearest_solution(goals, np.vstack([before, self._probes(count)]), before, says, sides)
                q = q if more is None else more
                if q is not None and says is not None and says.ranges:
                    break  # there is one such solution
        if q is not None:
            return q, ""
        reached = self._nearest_solution(goals, np.vstack([before, self._probes(_STARTS[-1])]), before, None, sides)
        if reached is None:
            return None, "is out of the nominal robot's reach"
        return None, f"is reached by the nominal robot, but not in configuration {says.text if says else ''}"

    def _nearest_solution(
        self, goals: Goals, starts: FloatArray, before: FloatArray, says: Configuration | None, sides: Sides
    ) -> FloatArray | None:
        """The solution nearest to the pose before, among those that agree with the program."""
        closed = self.robot.close(starts)
        reach = problem(self.robot, goals)
        index = np.flatnonzero(closed.ok)
        start = GoalConfigurations.unknown(starts[index], closed.passive[index])
        reached = descend(reach, np.zeros(len(index), dtype=np.intp), start)
        tolerance = _REACHED if len(before) >= 6 else _ROUNDED
        solutions = [self._with_full_turns(q, before, says) for q in reached.actuated[reached.distance <= tolerance]]
        solutions = [q for q in solutions if says is None or self.distance_to_statement(q, says, sides) <= _BORDER]
        return min(solutions, key=lambda q: float(np.linalg.norm(q - before)), default=None)

    def _with_full_turns(self, q: FloatArray, before: FloatArray, says: Configuration | None) -> FloatArray:
        """The same pose with whole turns of joints added, in the stated ranges and near the pose before."""
        lower, upper, turned = self._lower, self._upper, q[: len(before)].copy()
        for j in np.flatnonzero(self.robot.mechanism.actuated_repeats).tolist():
            low, high = says.ranges.get(j, (-np.inf, np.inf)) if says else (-np.inf, np.inf)
            turns = [turned[j] + 2 * np.pi * k for k in (-1, 0, 1)]
            turns = [value for value in turns if lower[j] - _ALIKE <= value <= upper[j] + _ALIKE] or [turned[j]]
            turned[j] = min(turns, key=lambda v: (max(low - v, v - high, 0.0) > _BORDER, abs(v - before[j])))
        return turned

    def distance_to_statement(self, q: FloatArray, says: Configuration, sides: Sides) -> float:
        """Return the distance of joints (n_actuated,) from a stated configuration [rad]; inf where a side differs."""
        pairs = zip(sides.sides_at(q), says.sides, strict=True) if says.sides != NO_SIDES else ()
        if any(stated is not None and side not in (None, stated) for side, stated in pairs):
            return np.inf
        off = (max(low - q[j], q[j] - high, 0.0) for j, (low, high) in says.ranges.items() if j < len(q))
        return max(off, default=0.0)


class Sides:
    """The sides of the wrist of a six-axis arm, relative to a reference pose of joints (n_actuated,) [m or rad].

    `remedy` names this pose, and what to do if it lies on a border between two sides.
    """

    def __init__(self, robot: Robot, reference: FloatArray, remedy: str) -> None:
        self.robot, self.remedy = robot, remedy
        joints = {joint.name: joint for joint in robot.urdf.joints}
        self._joints = [joints[name] for name in robot.joint_names]
        self._known = len(self._joints) == 6 and not robot.mechanism.loops
        self._reference = self._measures(reference) if self._known else (np.zeros(3), 0.0, 0.0)
        self._decided = (*(side is not None for side in self.sides_at(reference)[:3]), True)

    def are_undecided(self, says: Configuration) -> bool:
        """Whether the reference pose lies on the border of a stated side, so that the side means nothing."""
        pairs = zip(says.sides, self._decided, strict=True)
        return self._known and any(stated is not None and not decided for stated, decided in pairs)

    def sides_at(self, q: FloatArray) -> FourSides:
        """Return `Configuration.sides` at joints (n_actuated,) [m or rad].

        None where undefined: for an arm that is no chain of six axes, and on the border of two sides.
        """
        if not self._known:
            return NO_SIDES
        out, line, wrist = self._measures(q)
        reference, reference_line, reference_wrist = self._reference
        products = (float(out @ reference), line * reference_line, wrist * reference_wrist, -line)
        behind, elbow, flipped, bent = (value < 0 if abs(value) > _ALIKE else None for value in products)
        return behind, elbow, flipped, bent

    def _measures(self, q: FloatArray) -> tuple[FloatArray, float, float]:
        """The wrist from axis 1 in link 1 [m], a signed measure of elbow bend [m^2], and the value of joint 5 [rad]."""
        links = [np.asarray(self.robot.forward(q, joint.child)) for joint in self._joints]
        first, second, third, wrist = links[0], links[1][:3, 3], links[2][:3, 3], links[4][:3, 3]
        axis = np.array(self._joints[0].axis)
        out = first[:3, :3].T @ (wrist - first[:3, 3])
        turning = links[2][:3, :3] @ np.array(self._joints[2].axis)
        return out - axis * (axis @ out), float(np.cross(third - second, wrist - third) @ turning), float(q[4])

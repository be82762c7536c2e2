"""What the paper's 36 parameters cannot describe and it blames for the error that remains: a simulated robot has it.

Backlash of the rail
    The carriage stops half the backlash short of where the screw has turned to: q1 is off by -b/2 where it was
    approached in the positive direction, by +b/2 otherwise.
Lead error
    The carriage moves (1 + e) times as far as commanded.
Links out of perpendicular
    The axes of the eight joints at A, B, C and D are tilted against x_B, each by small angles about the y and z axes of
    its own frame. The links then leave their plane, which moves the tool along x most of all.

The paper gives the lead error (50 um per 300 mm) but no size for the other two. Ours are chosen so that the error that
remains after calibration is about as large as the paper's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from calib.arrays import FloatArray, IntArray
from calib.model.robot import Robot

TILTED_JOINTS = ("q2", "q3", "q4", "q5", "B1", "D1", "B2", "D2")


@dataclass(frozen=True)
class Imperfections:
    """Sizes of what the parameters leave out.

    Attributes:
        backlash: b of the module docstring [m].
        lead: e of the module docstring [m per m].
        tilt: Standard deviation of the tilt of each axis, about y and about z [rad].
    """

    backlash: float = 0.8e-3
    lead: float = 50e-6 / 0.3
    tilt: float = float(np.radians(0.06))

    @property
    def causes(self) -> dict[str, Imperfections]:
        """Each cause alone, by its name."""
        none = Imperfections(0.0, 0.0, 0.0)
        return {
            "tracker noise alone": none,
            "lead error": replace(none, lead=self.lead),
            "links out of perpendicular": replace(none, tilt=self.tilt),
            "backlash of the rail": replace(none, backlash=self.backlash),
        }

    @property
    def sizes(self) -> dict[str, str]:
        """How large each of them is, by the names of `causes`."""
        return {
            "lead error": f"{self.lead * 0.3 * 1e6:g} um per 300 mm",
            "links out of perpendicular": f"{np.degrees(self.tilt):.2g} deg (std of each axis)",
            "backlash of the rail": f"{1e3 * self.backlash:g} mm",
        }

    def __str__(self) -> str:
        """What there is, in words."""
        present = {
            "lead error": self.lead,
            "links out of perpendicular": self.tilt,
            "backlash of the rail": self.backlash,
        }
        return ", ".join(f"{name} of {self.sizes[name]}" for name, size in present.items() if size) or "nothing more"


@dataclass(frozen=True, eq=False)
class ImperfectRobot:
    """A simulated robot that does not quite do what it is told.

    Attributes:
        robot: Its mechanism, axes tilted.
        imperfections: Sizes.
        order: The order in which it visits the poses, which decides the direction of approach, (n,).
    """

    robot: Robot
    imperfections: Imperfections
    order: IntArray

    def positions(self, joints: FloatArray) -> FloatArray:
        """Where the tool really is at commanded joints (n, 6) [m, rad], in the world, (n, 3) [m]."""
        moved = joints.copy()
        moved[:, 0] = joints[:, 0] * (1 + self.imperfections.lead) - self._approach(joints[:, 0]) * (
            self.imperfections.backlash / 2
        )
        return self.robot.positions(moved)[:, 0]

    def _approach(self, q1: FloatArray) -> FloatArray:
        """+1 where q1 was approached in the positive direction, else -1, (n,); the first pose comes from home."""
        visited = q1[self.order]
        before = np.concatenate([[self.robot.home[0]], visited[:-1]])
        signs = np.empty(len(q1))
        signs[self.order] = np.where(visited >= before, 1.0, -1.0)
        return signs


def imperfect_robot(
    robot: Robot, imperfections: Imperfections, n_poses: int, generator: np.random.Generator
) -> ImperfectRobot:
    """Make a robot imperfect.

    Args:
        robot: The robot with its true parameters.
        imperfections: Sizes.
        n_poses: How many poses it will visit, in random order.
        generator: Source of the tilts and of the order.
    """
    tilts = generator.normal(0.0, imperfections.tilt, (len(TILTED_JOINTS), 2))
    placements = {}
    for name, (about_y, about_z) in zip(TILTED_JOINTS, tilts, strict=True):
        placement = robot.mechanism.placement(name)
        turn = pin.exp3(np.array([0.0, about_y, about_z]))
        placements[name] = pin.SE3(placement.rotation @ turn, placement.translation)
    tilted = replace(robot, mechanism=robot.mechanism.with_placements(placements))
    return ImperfectRobot(tilted, imperfections, generator.permutation(n_poses))

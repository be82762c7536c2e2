"""Imperfections of a simulated robot that the paper's 36 parameters cannot describe, and that the paper blames for the
error that remains.

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

All three are parameter values of the extended model (`urdf/medrue_extended.yaml`), and so is an error that repeats with
every turn of the screw. A model that has everything that the truth has would be judged too kindly. So a robot may have
two more errors that no model here has: a screw that is worn in the middle of the stroke, where its backlash is larger,
and a rail that is bent sideways. Their sizes are those of ordinary parts; nobody measured them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.parameter import index_of
from calib.core.base.units import quantity_text
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Context

TILTED_JOINTS = ("q2", "q3", "q4", "q5", "B1", "D1", "B2", "D2")
_CAUSES = {"lead error": "lead", "links out of perpendicular": "tilt", "backlash of the rail": "backlash"}
"""Causes of errors, and the attribute of `Imperfections` with the size of each."""
STROKE = 0.7
"""Stroke of the rail [m]."""


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
        alone = {name: replace(none, **{size: getattr(self, size)}) for name, size in _CAUSES.items()}
        return {"tracker noise alone": none, **alone}

    @property
    def sizes(self) -> dict[str, str]:
        """Size of each cause in words, by the names of `causes`."""
        return {
            "lead error": f"{quantity_text(self.lead * 0.3, 'um', 'g')} per 300 mm",
            "links out of perpendicular": f"{quantity_text(self.tilt, 'deg', '.2g')} (std of each axis)",
            "backlash of the rail": f"{quantity_text(self.backlash, 'mm', 'g')}",
        }

    def __str__(self) -> str:
        """The imperfections in words."""
        present = [f"{name} of {self.sizes[name]}" for name, size in _CAUSES.items() if getattr(self, size)]
        return ", ".join(present) or "nothing more"


@dataclass(frozen=True)
class RailErrors:
    """Smaller errors of the rail, which affect the measurement from both sides too.

    Attributes:
        periodic: Amplitude of the error that repeats with every turn of the screw; the extended model has it [m].
        wear: Part by which backlash is larger in the middle of the stroke; no model has it.
        bow: How far the rail is bent in the middle, along the base's y and along its z; no model has it [m].
    """

    periodic: float = 10e-6
    wear: float = 0.05
    bow: float = 20e-6

    def __str__(self) -> str:
        """The imperfections in words."""
        return (
            f"an error of each turn of the screw of {quantity_text(self.periodic, 'mm', 'g')}, backlash that is"
            f" {100 * self.wear:g} % larger in the middle of the rail than at its ends, and a rail that is bent by"
            f" {quantity_text(self.bow, 'mm', 'g')}"
        )


STRAIGHT = RailErrors(0.0, 0.0, 0.0)
"""A rail without these errors, as in the paper's protocol."""


@dataclass(frozen=True, eq=False)
class ImperfectRobot:
    """A simulated robot that does not quite follow its commands.

    Attributes:
        robot: The extended model with the true values of its parameters.
        rail: Smaller errors of the rail.
    """

    robot: Robot
    rail: RailErrors = STRAIGHT

    def positions(self, joints: FloatArray, approach: FloatArray) -> FloatArray:
        """True positions of the tool in the world, (n, 3) [m].

        Args:
            joints: Commands, (n, 6) [m, rad].
            approach: Direction in which q1 was approached, +1 or -1, (n,).
        """
        middle = np.sin(np.pi * joints[:, 0] / STROKE)
        half_backlash = self.robot.values[index_of(self.robot.parameters, "q1.backlash")]
        moved = joints.copy()
        moved[:, 0] += self.rail.wear * middle * half_backlash * approach
        y_and_z = self.robot.mechanism.placement("base_origin").rotation[:, 1:]
        points = self.robot.positions(moved, Context.from_conditions(from_direction(approach), {}))[:, 0]
        return np.asarray(points + self.rail.bow * middle[:, None] * y_and_z.sum(axis=1))


def from_direction(approach: FloatArray) -> FloatArray:
    """Return the directions of all joints, of which q1's is `approach` (n,) and the others are unknown, (n, 6)."""
    directions = np.zeros((len(approach), 6))
    directions[:, 0] = approach
    return directions


def approach_in_order(q1: FloatArray, order: IntArray, home: float) -> FloatArray:
    """Return in which direction q1 moves to each pose, +1 or -1, (n,).

    q1 is that of each pose, (n,) [m], `order` that of the visits, (n,); the first comes from home [m].
    """
    visited = q1[order]
    before = np.concatenate([[home], visited[:-1]])
    signs = np.empty(len(q1))
    signs[order] = np.where(visited >= before, 1.0, -1.0)
    return signs


def imperfect_robot(
    extended: Robot,
    actual: Robot,
    imperfections: Imperfections,
    generator: np.random.Generator,
    rail: RailErrors = STRAIGHT,
) -> ImperfectRobot:
    """Make the extended model of a robot from its actual one, the paper's with its true parameters.

    The generator draws the tilts, and then the phase of the screw's turns if it has an error of these.
    """
    tilts = generator.normal(0.0, imperfections.tilt, (len(TILTED_JOINTS), 2))
    placements = {}
    for name, (about_y, about_z) in zip(TILTED_JOINTS, tilts, strict=True):
        placement = actual.mechanism.placement(name)
        turn = pin.exp3(np.array([0.0, about_y, about_z]))
        placements[name] = pin.SE3(placement.rotation @ turn, placement.translation)
    values = geometry(extended, replace(actual, mechanism=actual.mechanism.with_placements(placements)))
    values |= {"q1.gain": imperfections.lead, "q1.backlash": 0.0 - imperfections.backlash / 2}
    if rail.periodic:
        phase = generator.uniform(0.0, 2.0 * np.pi)
        values |= {"q1.sin1": rail.periodic * np.cos(phase), "q1.cos1": rail.periodic * np.sin(phase)}
    return ImperfectRobot(extended.with_parameters(values), rail)


def geometry(extended: Robot, like: Robot) -> dict[str, float]:
    """Return the values of the extended model's origins that give it the geometry of a robot of its URDF [m, rad]."""
    values: dict[str, float] = {}
    for joint in extended.urdf.joints:
        placement, nominal = like.mechanism.placement(joint.name), extended.nominal.placement(joint.name)
        turn = pin.log3(nominal.rotation.T @ placement.rotation)
        numbers = (*placement.translation, *turn)
        names = (f"{joint.name}.{component}" for component in ("x", "y", "z", "rx", "ry", "rz"))
        values |= {name: float(number) for name, number in zip(names, numbers, strict=True)}
    return values

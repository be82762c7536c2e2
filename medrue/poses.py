"""The 420 poses of the target workspace, with joint values from the general inverse kinematics.

`calib.programs.reaching.inverse` solves them through the loops in Pinocchio; the closed-form inverse is solved beside
it, and the two must agree, so that an error in either is seen before anything is measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import ComputationError
from calib.core.base.units import millimetres
from calib.core.data.measurements import Poses
from calib.core.robots.robot import Robot
from calib.programs.reaching.goals import Goals
from calib.programs.reaching.inverse import solve
from medrue.closed_form import singularity_sines
from medrue.closed_form_inverse import inverse
from medrue.paper_tables import table1
from medrue.workspace import target_workspace

AGREEMENT = 1e-10
"""Largest difference between the two inverses that rounding explains [m, rad]."""


@dataclass(frozen=True, eq=False)
class TargetPoses:
    """The poses and what is known of them.

    Attributes:
        poses: Joint values, named 1 to 420.
        positions: Where the nominal robot brings the tool, (420, 1, 3) [m].
        difference: Largest difference of a joint from the closed-form inverse [m, rad].
        singular_value: Smallest singular value of the scaled closures over all poses; 0 is singular.
        sine: Smallest sine of an angle between two links of a five-bar; 0 is singular.
        stroke: Smallest and largest q1 [m].
        tilt: Mean and largest angle of the probe from the shortest line to the leg's axis [rad].
    """

    poses: Poses
    positions: FloatArray
    difference: float
    singular_value: float
    sine: float
    stroke: tuple[float, float]
    tilt: tuple[float, float]


def pose_facts(targets: TargetPoses) -> dict[str, object]:
    """Return where the poses are, how they are spread and how safe they are, as plain data with units in the names."""
    workspace = target_workspace()
    offset = workspace.T_world_tool[:, :3, 3] - workspace.p_axis
    angles = np.degrees(np.arctan2(offset[:, 2], offset[:, 1])) % 360
    x = millimetres(workspace.T_world_tool[:, 0, 3])
    return {
        "poses": len(targets.poses),
        "axis_of_the_leg_from_mm": [millimetres(c) for c in workspace.p_axis],
        "axis_of_the_leg_to_mm": [millimetres(c) for c in workspace.p_axis + workspace.length * workspace.axis],
        "radius_mm": millimetres(workspace.radius),
        "positions_along_x_mm": [float(x.min()), float(x.max())],
        "positions_from_y_towards_z_deg": [float(angles.min()), float(angles.max())],
        "different_x_and_angles": [len(np.unique(values.round(6))) for values in (x, angles)],
        "probe_tilt_mean_and_largest_deg": [float(np.degrees(angle)) for angle in targets.tilt],
        "q1_mm": [millimetres(q) for q in targets.stroke],
        "smallest_singular_value_of_the_loops": targets.singular_value,
        "smallest_sine_between_links": targets.sine,
        "largest_difference_from_closed_form_m_rad": targets.difference,
    }


def target_poses(robot: Robot) -> TargetPoses:
    """Solve the 420 poses.

    Args:
        robot: MedRUE with nominal parameters.

    Raises:
        ComputationError: The two inverses disagree.
        UnreachablePoseError: A pose is out of reach.
    """
    workspace = target_workspace()
    T = workspace.T_world_tool
    solution = solve(robot, Goals(T[:, :3, 3], T[:, :3, :3]))
    solution.require_all()
    difference = float(np.max(np.abs(solution.q - inverse(T, table1().nominal))))
    if not difference <= AGREEMENT:
        raise ComputationError(
            f"the inverse kinematics through the loops differs from the closed form by {difference:.2g} (m or rad);"
            " the robot description is not the nominal MedRUE, or one of the two is wrong"
        )
    names = tuple(str(k + 1) for k in range(len(T)))
    poses = Poses(solution.q, tuple(f"pose {name}" for name in names), names, "target workspace", ())
    offset = T[:, :3, 3] - workspace.p_axis
    outward = offset - (offset @ workspace.axis)[:, None] * workspace.axis
    towards_axis = -np.sum(outward * T[:, :3, 2], axis=1) / np.linalg.norm(outward, axis=1)
    tilt = np.arccos(np.clip(towards_axis, -1.0, 1.0))
    q1 = solution.q[:, 0]
    return TargetPoses(
        poses,
        robot.positions(solution.q),
        difference,
        float(robot.singular_values(robot.assemble(solution.q)).min()),
        float(singularity_sines(solution.q, table1().nominal).min()),
        (float(q1.min()), float(q1.max())),
        (float(tilt.mean()), float(tilt.max())),
    )

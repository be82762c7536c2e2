"""The 420 poses of the target workspace, with joint values from the general inverse kinematics.

`calib.programs.reaching.inverse` solves them through the loops in Pinocchio; the closed-form inverse is solved beside
it, and the two must agree, so that an error in either is seen before anything is measured.
"""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import ComputationError
from calib.core.base.units import in_unit, millimetres
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


def target_poses(robot: Robot) -> Poses:
    """Solve the 420 poses, named 1 to 420, of MedRUE with nominal parameters.

    Raises:
        ComputationError: The two inverses disagree.
        UnreachablePoseError: A pose is out of reach.
    """
    T = target_workspace().T_world_tool
    solution = solve(robot, Goals(T[:, :3, 3], T[:, :3, :3]))
    solution.require_all()
    difference = _closed_form_difference(solution.q)
    if not difference <= AGREEMENT:
        raise ComputationError(
            f"the inverse kinematics through the loops differs from the closed form by {difference:.2g} (m or rad);"
            " the robot description is not the nominal MedRUE, or one of the two is wrong"
        )
    names = tuple(str(k + 1) for k in range(len(T)))
    return Poses(solution.q, tuple(f"pose {name}" for name in names), names, "target workspace", ())


def _closed_form_difference(q: FloatArray) -> float:
    """Largest difference of joint values (420, 6) from the closed-form inverse [m, rad]."""
    return float(np.max(np.abs(q - inverse(target_workspace().T_world_tool, table1().nominal))))


def pose_facts(robot: Robot, poses: Poses) -> dict[str, object]:
    """Return where the 420 poses are, how they are spread and how safe they are, as plain data with units in the names.

    The tilt is the angle of the probe from the shortest line to the leg's axis; a smallest value of 0 is singular.
    """
    workspace, q = target_workspace(), poses.joints
    T = workspace.T_world_tool
    offset = T[:, :3, 3] - workspace.p_axis
    angles = in_unit(np.arctan2(offset[:, 2], offset[:, 1]), "deg") % 360
    x, stroke = millimetres(T[:, 0, 3]), millimetres(q[:, 0])
    outward = offset - (offset @ workspace.axis)[:, None] * workspace.axis
    towards_axis = -np.sum(outward * T[:, :3, 2], axis=1) / np.linalg.norm(outward, axis=1)
    tilt = in_unit(np.arccos(np.clip(towards_axis, -1.0, 1.0)), "deg")
    return {
        "poses": len(poses),
        "axis_of_the_leg_from_mm": millimetres(workspace.p_axis).tolist(),
        "axis_of_the_leg_to_mm": millimetres(workspace.p_axis + workspace.length * workspace.axis).tolist(),
        "radius_mm": millimetres(workspace.radius),
        "positions_along_x_mm": [float(x.min()), float(x.max())],
        "positions_from_y_towards_z_deg": [float(angles.min()), float(angles.max())],
        "different_x_and_angles": [len(np.unique(values.round(6))) for values in (x, angles)],
        "probe_tilt_mean_and_largest_deg": [float(tilt.mean()), float(tilt.max())],
        "q1_mm": [float(stroke.min()), float(stroke.max())],
        "smallest_singular_value_of_the_loops": float(robot.singular_values(robot.assemble(q)).min()),
        "smallest_sine_between_links": float(singularity_sines(q, table1().nominal).min()),
        "largest_difference_from_closed_form_m_rad": _closed_form_difference(q),
    }

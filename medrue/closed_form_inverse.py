"""Inverse kinematics of MedRUE in closed form.

The problem
    Given a pose of the tool in the world, find the six joint values.

Derivation (notation and equations as in `medrue.closed_form`)
    1. T_B6 follows from T_world_tool by taking away the base and the tool point. Its rotation is
       R_B6 = Rx(gamma) Ry(beta) Rz(alpha), so that gamma = atan2(-R_23, R_33).
    2. G_1 = p_B6 - (d41 + d5) u with u = R_B6 e_x. From it, E_1 in the y-z plane, and q1 = G_1x + d41 - dq1.
    3. The gap from G_1 to G_2 points along u and has the x component d41 + d42, so
       E_2 = E_1 + (u_y, u_z) (d41 + d42) / u_x. This asks for u_x > 0.
    4. Each pair of links is a triangle: with r = |E - A|, the angle at A between A E and A B is
       acos((L_1^2 + r^2 - L_2^2) / (2 L_1 r)). B lies on either side of A E: two working modes for each of the four
       pairs. The turn at the elbow (the sign of the passive joint B or D) names the side.
    5. q6 = gamma - q_DE1 - dq6.
    A solution in which E lies to the right of the line from D to B belongs to the other assembly mode, which the
    robot cannot reach without passing a singular pose. It is refused.

When it fails
    Out of reach, u_x <= 0, or the wrong assembly mode: all six values of that pose are NaN. Joint limits are not
    looked at.
"""

from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import ArrayLike, NDArray

from medrue.closed_form import Array, Named, Points, anchors, base_in_world, name_parameters


@dataclass(frozen=True)
class WorkingMode:
    """Choice among the inverse's solutions.

    Attributes:
        elbow_signs: Signs of the passive joints B1, D1, B2, D2: +1 where the distal link turns from the proximal
            link's direction in the positive sense about x_B, -1 otherwise.
        q6_centre: q6 is given within half a turn of this value [rad]. q2 to q5 are within half a turn of 0.
    """

    elbow_signs: tuple[int, int, int, int] = (1, -1, 1, -1)
    q6_centre: float = -pi / 2.0


ELBOWS_APART = WorkingMode()
"""Working mode of the home: the elbows of each five-bar are apart, so that its links do not cross."""


def inverse(T_world_tool: ArrayLike, parameters: ArrayLike, mode: WorkingMode = ELBOWS_APART) -> Array:
    """Joint values that bring the tool to given poses.

    Args:
        T_world_tool: Poses of the tool in the world, `(n, 4, 4) [m]`.
        parameters: Values of `PARAMETERS`, `(36,)` or one set per pose `(n, 36) [m, rad]`.
        mode: The working mode of the solution.

    Returns:
        Joint values q1 to q6, `(n, 6) [m, rad]`; a row of NaN where a pose cannot be reached in this mode.

    Raises:
        ValueError: A shape is wrong.
    """
    T = np.asarray(T_world_tool, dtype=float)
    if T.ndim != 3 or T.shape[1:] != (4, 4):
        raise ValueError(f"poses have shape {T.shape}, expected (n, 4, 4)")
    named = name_parameters(parameters, len(T))
    R, p_base_G1 = _support_in_base(T, named)
    gamma = np.arctan2(-R[:, 1, 2], R[:, 2, 2])
    E1: Points = p_base_G1[:, 1] + 1j * p_base_G1[:, 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        E2 = E1 + (R[:, 1, 0] + 1j * R[:, 2, 0]) * (named["d41"] + named["d42"]) / R[:, 0, 0]
        q2, q3, D1, feasible_1 = _five_bar_inverse(1, E1, named, mode.elbow_signs[:2])
        q4, q5, _, feasible_2 = _five_bar_inverse(2, E2, named, mode.elbow_signs[2:])
        q6 = _wrap(gamma - np.angle(E1 - D1) - named["dq6"], mode.q6_centre)
    q = np.stack([p_base_G1[:, 0] + named["d41"] - named["dq1"], q2, q3, q4, q5, q6], axis=1)
    gap_forwards = (R[:, 0, 0] > 0.0) & (named["d41"] + named["d42"] > 0.0)
    q[~(feasible_1 & feasible_2 & gap_forwards)] = np.nan
    return q


def _support_in_base(T_world_tool: Array, named: Named) -> tuple[Array, Array]:
    """Orientation of F_6 `(n, 3, 3)` and point G_1 `(n, 3) [m]` in the base."""
    R_world_base, p_world_base = base_in_world(named)
    R_base_world = np.transpose(R_world_base, (0, 2, 1))
    R = R_base_world @ T_world_tool[:, :3, :3]
    p_base_tool = np.einsum("nij,nj->ni", R_base_world, T_world_tool[:, :3, 3] - p_world_base)
    p_G1_tool = np.stack([named["d41"] + named["d5"] + named["xt"], named["yt"], named["zt"]], axis=1)
    return R, p_base_tool - np.einsum("nij,nj->ni", R, p_G1_tool)


def _five_bar_inverse(
    i: int, E: Points, named: Named, signs: tuple[int, ...]
) -> tuple[Array, Array, Points, NDArray[np.bool_]]:
    """Motor angles at A and C [rad], point D [m], and whether E is reachable, each `(n,)`."""
    A, C, x_axis = anchors(i, named)
    L1, L2, L3, L4 = (named[f"L{i}{j}"] for j in (1, 2, 3, 4))
    A_to_B = _proximal_direction(E - A, L1, L2, signs[0])
    C_to_D = _proximal_direction(E - C, L3, L4, signs[1])
    B, D = A + L1 * A_to_B, C + L3 * C_to_D
    left_of_D_to_B = (np.conj(B - D) * (E - D)).imag > 0.0
    angle_A = _wrap(np.angle(A_to_B / x_axis) - named[f"dq{2 * i}"], 0.0)
    angle_C = _wrap(np.angle(C_to_D / x_axis) - named[f"dq{2 * i + 1}"], 0.0)
    return angle_A, angle_C, D, left_of_D_to_B


def _proximal_direction(to_end: Points, proximal: Array, distal: Array, elbow_sign: int) -> Points:
    """Unit direction of a proximal link whose pair spans `to_end`, `(n,)`; NaN where it cannot."""
    reach = np.abs(to_end)
    angle = np.arccos((proximal**2 + reach**2 - distal**2) / (2.0 * proximal * reach))
    direction: Points = to_end / reach * np.exp(-1j * elbow_sign * angle)
    return direction


def _wrap(angle: Array, centre: float) -> Array:
    """The angle plus whole turns, within half a turn of `centre` [rad]."""
    return centre + np.remainder(angle - centre + pi, 2.0 * pi) - pi

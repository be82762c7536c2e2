"""Forward kinematics of MedRUE in closed form (equations 1 to 17 of the paper).

This module shares no code with the calibration engine or with Pinocchio, so that each can check the other.

The problem
    A carriage on a linear guide (q1, along x_B) carries two planar five-bars (i = 1, 2) in planes parallel to
    y_B-z_B. Each has motors at A_i and C_i, proximal links A_i B_i and C_i D_i, and distal links B_i E_i and
    D_i E_i that meet at E_i. A probe support joins E_1 and E_2 with universal joints at G_1 and G_2 and a passive
    slide at G_2; motor M6 turns it about x. Given six joint values, find the tool's pose.

Notation
    A point (y, z) of the base's y-z plane is the complex number y + i z, so a turn by theta about x_B is a product
    with exp(i theta). All angles are counted from +y_B towards +z_B.

Derivation
    Five-bar i, with the unit vector x_i = (A_i - C_i) / |A_i - C_i| = exp(i psi_i):
        B = A + L_i1 x_i exp(i (q_2i   + dq_2i))                                                       (4)
        D = C + L_i3 x_i exp(i (q_2i+1 + dq_2i+1))                                                     (5)
        k = ((L_i4^2 - L_i2^2) / |B - D|^2 + 1) / 2
        E = D + k (B - D) + sqrt(L_i4^2 - k^2 |B - D|^2) i (B - D) / |B - D|                        (8-10)
    These are the paper's equations, taken to the base's y-z plane at once (11-12). One assembly mode: E lies to
    the left of the line from D to B.
    The gap from G_1 to G_2 is (d41 + d42, E_2y - E_1y, E_2z - E_1z); u is its unit vector. Then
        gamma = q_DE1 + q6 + dq6
        alpha = asin(u_y cos gamma + u_z sin gamma)                                                     (14)
        beta  = atan2(u_y sin gamma - u_z cos gamma, u_x)                                               (15)
        R_B6  = Rx(gamma) Ry(beta) Rz(alpha), whose first column is u
        p_B6  = E_1 + (d31 - d41, 0, 0) + R_B6 (d41 + d5, 0, 0)                                         (16)
        p_B_tool = p_B6 + R_B6 (xt, yt, zt),  T_world_base = ((xb, yb, zb), Rz Ry Rx of phi_b)       (1, 2, 17)
    The paper writes sqrt(cos^2 alpha - first argument^2) for the second argument of (15); this is u_x.
    The inverse is in `medrue.closed_form_inverse`.

Decisions where the paper leaves a choice
    psi_i: equation 13 as printed does not put A_i back at (A_iy, A_iz). We ask for O_i + R_i (|C_i A_i| / 2, 0) = A_i,
        hence psi_i = atan2(A_iz - C_iz, A_iy - C_iy).
    q_DE1: its zero is not stated. We take q_DE1 = atan2(E_1z - D_1z, E_1y - D_1y).

When it fails
    Where a five-bar cannot close (the square root is not real, or B and D coincide) every output of that pose is
    NaN. The same holds for the inverse where a target is out of reach or needs the other assembly mode.

Reference: joubair2015.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from medrue.paper_tables import PARAMETERS

Array = NDArray[np.float64]
Points = NDArray[np.complex128]
Named = dict[str, Array]

ACTUATED_JOINTS = ("q1", "q2", "q3", "q4", "q5", "q6")
PASSIVE_JOINTS = ("B1", "D1", "B2", "D2", "beta", "alpha", "slide")


@dataclass(frozen=True)
class ClosedForm:
    """Poses of the tool and values of the passive joints; NaN where a pose does not close.

    Attributes:
        p_world_tool: Tool point in the world, `(n, 3) [m]`.
        R_world_tool: Orientation of frame F_6 (and of the tool) in the world, `(n, 3, 3)`.
        passive: Values of `PASSIVE_JOINTS` as joints of the URDF, `(n, 7) [rad]`, the last one [m].
        closes: Whether the loops close, `(n,)`.
    """

    p_world_tool: Array
    R_world_tool: Array
    passive: Array
    closes: NDArray[np.bool_]

    def joint(self, name: str) -> Array:
        """Values of one passive joint, `(n,) [rad or m]`."""
        return self.passive[:, PASSIVE_JOINTS.index(name)]

    @property
    def T_world_tool(self) -> Array:  # noqa: N802 - poses carry this name everywhere
        """Poses of the tool as homogeneous matrices, `(n, 4, 4) [m]`."""
        return homogeneous(self.R_world_tool, self.p_world_tool)


@dataclass(frozen=True)
class FiveBar:
    """The points of one five-bar in the base's y-z plane, each `(n,)`, y + i z [m]."""

    A: Points
    B: Points
    C: Points
    D: Points
    E: Points


def forward(q: ArrayLike, parameters: ArrayLike) -> ClosedForm:
    """Tool poses and passive joint values for given actuated joint values (equations 1 to 17).

    Args:
        q: Joint values q1 to q6, `(n, 6) [m, rad]`.
        parameters: Values of `PARAMETERS`, `(36,)` or one set per pose `(n, 36) [m, rad]`.

    Returns:
        Poses and passive joint values; NaN where `closes` is False.

    Raises:
        ValueError: A shape is wrong.
    """
    q = joint_matrix(q)
    named = name_parameters(parameters, len(q))
    with np.errstate(invalid="ignore", divide="ignore"):
        bar_1, bar_2 = five_bar(1, q, named), five_bar(2, q, named)
        gap = _gap(bar_1.E, bar_2.E, named)
        length = np.linalg.norm(gap, axis=1)
        u_x, u_y, u_z = (gap / length[:, None]).T
        gamma = np.angle(bar_1.E - bar_1.D) + q[:, 5] + named["dq6"]
        alpha = np.arcsin(np.clip(u_y * np.cos(gamma) + u_z * np.sin(gamma), -1.0, 1.0))
        beta = np.arctan2(u_y * np.sin(gamma) - u_z * np.cos(gamma), u_x)
        R_base_tool = rotation_x(gamma) @ rotation_y(beta) @ rotation_z(alpha)
        p_base_tool = _tool_in_base(q[:, 0] + named["dq1"], bar_1.E, R_base_tool, named)
        slide = length - (named["d41"] + named["d42"])
        passive = np.stack([*_elbows(bar_1), *_elbows(bar_2), beta, alpha, slide], axis=1)
    R_world_base, p_world_base = base_in_world(named)
    p_world_tool = p_world_base + np.einsum("nij,nj->ni", R_world_base, p_base_tool)
    R_world_tool = R_world_base @ R_base_tool
    closes = np.isfinite(passive).all(axis=1) & np.isfinite(p_world_tool).all(axis=1) & (gap[:, 0] > 0.0)
    for values in (p_world_tool, R_world_tool, passive):
        values[~closes] = np.nan
    for values in (p_world_tool, R_world_tool, passive, closes):
        values.setflags(write=False)
    return ClosedForm(p_world_tool, R_world_tool, passive, closes)


def five_bar(i: int, q: Array, named: Named) -> FiveBar:
    """The points of five-bar i (1 or 2) at joint values `(n, 6) [m, rad]` (equations 4 to 12), NaN if it stays open."""
    A, C, x_axis = anchors(i, named)
    L1, L2, L3, L4 = (named[f"L{i}{j}"] for j in (1, 2, 3, 4))
    angle_A = q[:, 2 * i - 1] + named[f"dq{2 * i}"]
    angle_C = q[:, 2 * i] + named[f"dq{2 * i + 1}"]
    B = A + L1 * x_axis * np.exp(1j * angle_A)
    D = C + L3 * x_axis * np.exp(1j * angle_C)
    base = np.abs(B - D)
    k = ((L4**2 - L2**2) / base**2 + 1.0) / 2.0
    height = np.sqrt(L4**2 - (k * base) ** 2)
    E = D + (k + 1j * height / base) * (B - D)
    return FiveBar(A, B, C, D, E)


def anchors(i: int, named: Named) -> tuple[Points, Points, Points]:
    """Anchors A_i and C_i, and the unit vector x_i from C_i to A_i, each `(n,)`, y + i z [m]."""
    A = named[f"A{i}y"] + 1j * named[f"A{i}z"]
    C = named[f"C{i}y"] + 1j * named[f"C{i}z"]
    return A, C, (A - C) / np.abs(A - C)


def singularity_sines(q: ArrayLike, parameters: ArrayLike) -> Array:
    """Distance to the singular poses of each five-bar, as sines of the angles between its links.

    At E: 0 where the distal links are aligned, so that the motors no longer hold E (parallel singularity, the
    border between assembly modes). At B and at D: 0 where an arm is stretched or folded, so that E cannot move
    along it (serial singularity, the border between working modes). 1 is farthest from both.

    Args:
        q: Joint values, `(n, 6) [m, rad]`.
        parameters: `(36,)` or `(n, 36) [m, rad]`.

    Returns:
        Absolute sines at (B, D, E) of five-bars 1 and 2, `(n, 2, 3)`; NaN where the pose does not close.
    """
    q = joint_matrix(q)
    named = name_parameters(parameters, len(q))
    with np.errstate(invalid="ignore", divide="ignore"):
        bars = [five_bar(i, q, named) for i in (1, 2)]
        angles = [(*_elbows(bar), np.angle((bar.E - bar.B) / (bar.E - bar.D))) for bar in bars]
    sines: Array = np.abs(np.sin(np.transpose(np.array(angles), (2, 0, 1))))
    return sines


def joint_matrix(q: ArrayLike) -> Array:
    """The joint values as an array `(n, 6)`, or a ValueError."""
    q = np.asarray(q, dtype=float)
    if q.ndim != 2 or q.shape[1] != len(ACTUATED_JOINTS):
        raise ValueError(f"joint values have shape {q.shape}, expected (n, 6): q1 [m], q2 ... q6 [rad]")
    return q


def name_parameters(parameters: ArrayLike, n: int) -> Named:
    """Parameters by name, each broadcast to `(n,)`, or a ValueError."""
    values = np.asarray(parameters, dtype=float)
    if values.shape not in ((len(PARAMETERS),), (n, len(PARAMETERS))):
        raise ValueError(f"parameters have shape {values.shape}, expected (36,) or ({n}, 36)")
    return dict(zip(PARAMETERS, np.broadcast_to(values, (n, len(PARAMETERS))).T, strict=True))


def base_in_world(named: Named) -> tuple[Array, Array]:
    """Orientation `(n, 3, 3)` and origin `(n, 3) [m]` of the base in the world (equation 2)."""
    R = rotation_z(named["phi_bz"]) @ rotation_y(named["phi_by"]) @ rotation_x(named["phi_bx"])
    return R, np.stack([named["xb"], named["yb"], named["zb"]], axis=1)


def _elbows(bar: FiveBar) -> tuple[Array, Array]:
    """Turns from the proximal to the distal links at B and D, in (-pi, pi], each `(n,) [rad]`."""
    return np.angle((bar.E - bar.B) / (bar.B - bar.A)), np.angle((bar.E - bar.D) / (bar.D - bar.C))


def _gap(E1: Points, E2: Points, named: Named) -> Array:
    """Vector from G_1 to G_2 in the base, `(n, 3) [m]`."""
    return np.stack([named["d41"] + named["d42"], (E2 - E1).real, (E2 - E1).imag], axis=1)


def _tool_in_base(carriage: Array, E1: Points, R_base_tool: Array, named: Named) -> Array:
    """Tool point in the base (equation 16 and the tool), `(n, 3) [m]`; `carriage` is q1 + dq1."""
    p_base_E1 = np.stack([carriage - named["d31"], E1.real, E1.imag], axis=1)
    p_E1_G1 = np.stack([named["d31"] - named["d41"], *np.zeros((2, len(carriage)))], axis=1)
    p_G1_tool = np.stack([named["d41"] + named["d5"] + named["xt"], named["yt"], named["zt"]], axis=1)
    p_base_tool: Array = p_base_E1 + p_E1_G1 + np.einsum("nij,nj->ni", R_base_tool, p_G1_tool)
    return p_base_tool


def rotation_x(angle: Array) -> Array:
    """Rotations about x, `(n, 3, 3)`, for angles `(n,) [rad]`."""
    return _rotation(angle, 1, 2)


def rotation_y(angle: Array) -> Array:
    """Rotations about y, `(n, 3, 3)`, for angles `(n,) [rad]`."""
    return _rotation(angle, 2, 0)


def rotation_z(angle: Array) -> Array:
    """Rotations about z, `(n, 3, 3)`, for angles `(n,) [rad]`."""
    return _rotation(angle, 0, 1)


def _rotation(angle: Array, first: int, second: int) -> Array:
    """Rotations that take axis `first` towards axis `second`."""
    R = np.tile(np.eye(3), (len(angle), 1, 1))
    R[:, first, first] = R[:, second, second] = np.cos(angle)
    R[:, second, first] = np.sin(angle)
    R[:, first, second] = -np.sin(angle)
    return R


def homogeneous(R: Array, p: Array) -> Array:
    """Matrices `(n, 4, 4)` from rotations `(n, 3, 3)` and points `(n, 3)`."""
    T = np.zeros((len(p), 4, 4))
    T[:, :3, :3] = R
    T[:, :3, 3] = p
    T[:, 3, 3] = 1.0
    return T

"""A calibration as somebody writes it for one serial arm: batched numpy, Gauss and Newton's steps, and no more.

It shares no code with `calib`, which it is the measure of: of speed (`performance.py`), and of the minimum that is
reached. Model: all joint origins of a chain (x, y, z and a rotation vector, each with a prior), the place of the base
in the measurement frame (no prior), the place of the measured point in the last link (a prior).
"""

import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Arm:
    """A chain of joints, root first.

    Attributes:
        xyz, rpy: Nominal origins, (k, 3) each.
        axes: Joint axes, zero for joints that do not move, (k, 3).
        column: Column of joint values that each joint takes, -1 for none, (k,).
        point: Measured point in the last link, (3,).
        sigma: Of the origins' x, y, z, of their rotation vectors, and of the point.
    """

    xyz: np.ndarray
    rpy: np.ndarray
    axes: np.ndarray
    column: np.ndarray
    point: np.ndarray
    sigma: tuple[float, float, float]

    @staticmethod
    def read(urdf, tip, motors, point, sigma):
        """The chain of a URDF's text from its root to a link."""
        by_child = {joint.find("child").get("link"): joint for joint in ET.fromstring(urdf).iter("joint")}
        chain = []
        while tip in by_child:
            chain.insert(0, by_child[tip])
            tip = by_child[tip].find("parent").get("link")

        def numbers(joint, tag, key, default):
            element = joint.find(tag)
            return [float(x) for x in (default if element is None else element.get(key, default)).split()]

        origins = [[numbers(joint, "origin", key, "0 0 0") for joint in chain] for key in ("xyz", "rpy")]
        moves = [joint.get("name") in motors for joint in chain]
        moving = list(zip(chain, moves, strict=True))
        axes = [numbers(joint, "axis", "xyz", "1 0 0") if use else [0, 0, 0] for joint, use in moving]
        column = [motors.index(joint.get("name")) if use else -1 for joint, use in moving]
        return Arm(*map(np.array, (*origins, axes, column, point)), sigma)


def crossed(v):
    """The matrices [v]x, (..., 3, 3)."""
    x, y, z = np.moveaxis(v, -1, 0)
    zero = np.zeros_like(x)
    return np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), (0, 1), (-2, -1))


def turned(axes, angles):
    """Rodrigues' formula, axes (..., 3) of length one or zero, angles (...)."""
    K = crossed(axes)
    s, c = np.sin(angles)[..., None, None], np.cos(angles)[..., None, None]
    return np.eye(3) + s * K + (1 - c) * (K @ K)


def fit(arm, q, measured, noise, tolerance=1e-12):
    """Return the cost reached and the number of evaluations.

    Args:
        arm: The nominal arm.
        q: Joint values, (n, n_joints) [rad].
        measured: Positions, (n, 3) [m].
        noise: Standard deviation per axis [m].
        tolerance: Promised decrease of the cost that ends it.
    """
    k = len(arm.xyz)
    scale = np.concatenate([np.tile([arm.sigma[0]] * 3 + [arm.sigma[1]] * 3, k), [arm.sigma[2]] * 3])
    u = np.zeros(6 * k + 3)
    spin = turned(arm.axes[arm.column >= 0], q[:, arm.column[arm.column >= 0]])
    R_base = p_base = None
    for evaluations in range(1, 100):
        p, J = positions(arm, u * scale, spin)
        if R_base is None:  # lay the nominal positions over the measured ones
            U, _, Vt = np.linalg.svd((p - p.mean(0)).T @ (measured - measured.mean(0)))
            R_base = (U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt).T
            p_base = measured.mean(0) - R_base @ p.mean(0)
        there = p @ R_base.T
        r = (there + p_base - measured).ravel() / noise
        by_base = np.zeros((len(q), 3, 6))
        by_base[:, :, :3] = np.eye(3)
        for axis, e in enumerate(np.eye(3)):
            by_base[:, :, 3 + axis] = np.cross(e, there)
        A = np.concatenate([R_base @ (J * scale), by_base], axis=2).reshape(3 * len(q), -1) / noise
        A = np.vstack([A, np.eye(len(u), len(u) + 6)])
        r = np.concatenate([r, u])
        Q, triangle = np.linalg.qr(A)
        pull = Q.T @ r
        if pull @ pull <= tolerance * (r @ r):
            return float(r @ r), evaluations
        step = -np.linalg.solve(triangle, pull)
        u = u + step[:-6]
        p_base = p_base + step[-6:-3]
        angle = np.linalg.norm(step[-3:])
        R_base = turned(step[-3:] / max(angle, 1e-300), angle) @ R_base
    raise RuntimeError("no convergence")


def positions(arm, change, spin):
    """Positions of the point in the root link, (n, 3), and their derivatives, (n, 3, 6 k + 3)."""
    n, k = len(spin), len(arm.xyz)
    change, point = change[:-3].reshape(k, 6), arm.point + change[-3:]
    xyz, vector = arm.xyz + change[:, :3], change[:, 3:]
    angle = np.sqrt(np.sum(vector**2, axis=1) + 1e-30)
    e = np.eye(3)
    nominal = turned(e[2], arm.rpy[:, 2]) @ turned(e[1], arm.rpy[:, 1]) @ turned(e[0], arm.rpy[:, 0])
    fixed, K = nominal @ turned(vector / angle[:, None], angle), crossed(vector)
    half = np.where(angle > 1e-4, (1 - np.cos(angle)) / angle**2, 0.5)[:, None, None]
    third = np.where(angle > 1e-4, (angle - np.sin(angle)) / angle**3, 1 / 6)[:, None, None]
    axes = fixed @ (e - half * K + third * (K @ K))
    R, p, moving, parents, places = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3)), 0, [], []
    for j in range(k):
        parents.append(R)
        p = p + R @ xyz[j]
        places.append(p)
        R = R @ fixed[j]
        if arm.column[j] >= 0:
            R = R @ spin[:, moving]
            moving += 1
    tool = p + R @ point
    R_parent, arm_of = np.stack(parents, axis=1), tool[:, None] - np.stack(places, axis=1)
    turning = R_parent @ axes
    by_angle = np.cross(turning, arm_of[..., None], axisa=2, axisb=2, axisc=2)
    columns = np.concatenate([R_parent, by_angle], axis=3).transpose(0, 2, 1, 3).reshape(n, 3, 6 * k)
    return tool, np.concatenate([columns, R], axis=2)

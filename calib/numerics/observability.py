"""Observability indices: how well a set of poses determines the parameters, as one number.

With singular values s1 >= ... >= sn of the identification Jacobian (n kept columns, m poses):

    O1 = (s1 s2 ... sn)^(1/n) / sqrt(m)      Borm and Menq 1989
    O2 = sn / s1                             Driels and Pathre 1990
    O3 = sn                                  Nahvi and Hollerbach 1994
    O4 = sn^2 / s1                           Nahvi and Hollerbach 1996
    O5 = 1 / (1/s1 + ... + 1/sn)             Sun and Hollerbach 2008

Only the order that O1 gives does not depend on the units of the parameters (a change of units multiplies every O1 by
the same number); the others are meaningful on scaled columns. None of them is what a user wants to know. That is the

    task index: root mean square over poses of the predicted distance between true and predicted position,

for poses where the robot will work, given the poses that were measured and the noise; and its largest value.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray
from calib.numerics.identifiability import numerical_rank
from calib.parameter import Parameter
from calib.units import PER_SI

INDICES = ("O1", "O2", "O3", "O4", "O5")


def observability(singular_values: FloatArray, n_poses: int) -> dict[str, float]:
    """Return O1 to O5.

    >>> observability([4.0, 1.0], n_poses=4)
    {'O1': 1.0, 'O2': 0.25, 'O3': 1.0, 'O4': 0.25, 'O5': 0.8}

    Args:
        singular_values: All singular values of the Jacobian, as many as it has columns, largest first, (n,).
        n_poses: Number of poses m.

    Returns:
        Index by name; all are 0 where the Jacobian loses rank exactly.
    """
    s = np.asarray(singular_values, dtype=float)
    if s[-1] <= 0:
        return dict.fromkeys(INDICES, 0.0)
    return {
        "O1": float(np.exp(np.mean(np.log(s))) / np.sqrt(n_poses)),
        "O2": float(s[-1] / s[0]),
        "O3": float(s[-1]),
        "O4": float(s[-1] ** 2 / s[0]),
        "O5": float(1.0 / np.sum(1.0 / s)),
    }


def raw_columns(jacobian: FloatArray, parameters: Iterable[Parameter]) -> FloatArray:
    """Return the Jacobian in the units of tables, as the paper has it: mm per unit of each parameter (mm or deg).

    Args:
        jacobian: d(positions)/d(parameters), (..., n_parameters) [m per m or rad].
        parameters: The parameters of its columns.
    """
    per_unit = np.array([1.0 / PER_SI[parameter.dimension][parameter.unit] for parameter in parameters])
    result: FloatArray = PER_SI["length"]["mm"] * jacobian * per_unit
    return result


def observability_of(
    rows: FloatArray, parameters: Sequence[Parameter], n_poses: int
) -> tuple[dict[str, float], dict[str, float]]:
    """Return O1 to O5 of poses, on scaled columns [m] and on raw ones (mm per unit of table).

    Where the poses are short of rank they are taken over the singular values that are not zero.

    Args:
        rows: Scaled Jacobian, (..., n_parameters) [m]; leading axes are flattened.
        parameters: The parameters of its columns.
        n_poses: Number of poses that the rows are of.
    """
    width = rows.shape[-1]
    scales = np.array([parameter.sigma for parameter in parameters])
    scaled = numerical_rank(rows.reshape(-1, width))
    raw = numerical_rank(raw_columns(rows / scales, parameters).reshape(-1, width))
    kept = slice(max(scaled.rank, 1))
    return observability(scaled.singular_values[kept], n_poses), observability(raw.singular_values[kept], n_poses)


@dataclass(frozen=True)
class TaskIndex:
    """Predicted position error over a set of poses, from measurement noise alone.

    Attributes:
        rms: Root mean square over poses and targets of the predicted distance [m]; infinite where a position depends on
            parameters that nothing determines.
        maximum: Largest predicted distance [m].
        worst_pose: Pose of the largest.
    """

    rms: float
    maximum: float
    worst_pose: int


def task_index(position_errors: FloatArray) -> TaskIndex:
    """Summarise predicted position errors (n_poses, n_targets) [m], from `Information.position_errors`."""
    return TaskIndex(
        float(np.sqrt(np.mean(position_errors**2))),
        float(np.max(position_errors)),
        int(np.argmax(np.max(position_errors, axis=1))),
    )

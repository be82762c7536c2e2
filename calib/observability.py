"""Observability indices: how well a set of poses determines the parameters, as one number.

With singular values s1 >= ... >= sn of the identification Jacobian (n kept columns, m poses):

    O1 = (s1 s2 ... sn)^(1/n) / sqrt(m)      Borm and Menq 1989
    O2 = sn / s1                             Driels and Pathre 1990
    O3 = sn                                  Nahvi and Hollerbach 1994
    O4 = sn^2 / s1                           Nahvi and Hollerbach 1996
    O5 = 1 / (1/s1 + ... + 1/sn)             Sun and Hollerbach 2008

Only O1 does not depend on the units of the parameters; the others are meaningful on scaled columns.
"""

from __future__ import annotations

import numpy as np

from calib.mechanism import FloatArray

INDICES = ("O1", "O2", "O3", "O4", "O5")


def observability(singular_values: FloatArray, n_poses: int) -> dict[str, float]:
    """Return O1 to O5.

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

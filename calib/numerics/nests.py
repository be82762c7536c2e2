"""The world frame from nests that are fixed to the robot: a rigid fit with names, repeats and outliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calib.arrays import FloatArray
from calib.errors import DataError, nearest
from calib.numerics.rigid import RigidFit, best_transform, rigid_fit
from calib.units import millimetres


@dataclass(frozen=True, eq=False)
class WorldFrame:
    """The world frame found from nests that are fixed to the robot.

    Attributes:
        fit: Rigid fit from the instrument's frame to the world; its covariance is the frame's uncertainty.
        outliers: Names of nests that do not fit.
        excluded: Names of nests that were left out on request.
        repeatability: Standard deviation of one reading about its nest's mean, per axis; NaN without repeats [m].
    """

    fit: RigidFit
    outliers: tuple[str, ...]
    excluded: tuple[str, ...]
    repeatability: float


def world_from_nests(
    nominal: ArrayLike,
    measured: ArrayLike,
    sigma: float | None = None,
    *,
    names: Sequence[str] | None = None,
    exclude: Sequence[str] = (),
) -> WorldFrame:
    """Find the world frame from nests at known places on the robot, seen by an instrument in its own frame.

    `fit.apply` turns readings of the instrument into world coordinates. Nests that do not fit are reported, and left
    out only when they are named in `exclude`.

    Args:
        nominal: Nests in the world, (n, 3) [m].
        measured: Nests in the instrument's frame, (n, 3), or (n, n_repeats, 3) to be averaged [m].
        sigma: Noise of one component of `measured` (of its means, where repeats are given) [m]; estimated if not given.
        names: Names of the nests; `nest 1`, ... if not given.
        exclude: Names of nests to leave out.

    Raises:
        DataError: As for `rigid_fit`; an unknown name in `exclude`; points that fit only as a mirror image.
    """
    seen, known = np.asarray(measured, dtype=float), np.asarray(nominal, dtype=float)
    repeatability = float("nan")
    if seen.ndim == 3:
        if seen.shape[1] > 1:
            repeatability = float(np.sqrt(np.mean(np.var(seen, axis=1, ddof=1))))
        seen = seen.mean(axis=1)
    labels = list(names) if names is not None else [f"nest {k + 1}" for k in range(len(known))]
    if seen.shape != known.shape or len(labels) != len(known) or len(set(labels)) != len(labels):
        raise DataError(
            f"{len(known)} nests, {len(seen)} measured, {len(set(labels))} different names; each nest needs"
            " its place (x, y, z), its reading and a name of its own"
        )
    for name in exclude:
        if name not in labels:
            raise DataError(f"no nest '{name}' to leave out{nearest(name, labels)}")
    kept = np.array([name not in exclude for name in labels], dtype=bool)
    used = [name for name in labels if name not in exclude]
    fit = rigid_fit(seen[kept], known[kept], sigma, names=used)
    _refuse_mirror(seen[kept], known[kept], fit)
    return WorldFrame(fit, tuple(used[k] for k in fit.outliers), tuple(exclude), repeatability)


def _refuse_mirror(seen: FloatArray, known: FloatArray, fit: RigidFit) -> None:
    """Raise where points that do not fit would fit as a mirror image."""
    rotation, translation = best_transform(-seen, known)
    mirrored = float(np.sqrt(np.mean(np.sum((known + seen @ rotation.T - translation) ** 2, axis=1))))
    if fit.rms > 1e-3 and mirrored < 0.1 * fit.rms:
        raise DataError(
            f"the nests fit to {millimetres(mirrored):.3g} mm only as a mirror image ({millimetres(fit.rms):.3g} mm as"
            " they are); an axis has the wrong sign, or two columns are swapped"
        )

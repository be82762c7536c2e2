"""Ways to take the lens of a hand-eye calibration, each with what it makes of images left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.base.arrays import FloatArray
from calib.base.errors import ComputationError, NotIdentifiableError
from calib.instruments.camera import NAMES
from calib.photographs.estimation import plain
from calib.photographs.left_out import LeftOut, predicted
from calib.photographs.scene import Placed, Scene
from calib.photographs.shared_errors import Prior

LENSES = ("auto", "given", "found")
LENS_NUMBERS = tuple(NAMES.index(name) for name in ("fx", "fy", "cx", "cy", "k1", "k2"))
_FOCAL, _MIDDLE, _RADIAL = 0.1, 0.05, 0.5  # how far off: of the focal length, of the width; k1 and k2


def lens_prior(first: FloatArray, scene: Scene, given: bool) -> Prior:
    """Return what is expected of a lens: as wide as a mistake may be, so that images decide where they can.

    Args:
        first: Intrinsics to begin with, (9,).
        scene: The images.
        given: Whether these were given.
    """
    width = float(max(scene.size))
    focal = (_FOCAL if given else 1.0) * first[0]
    sigma = np.array([focal, focal, _MIDDLE * width, _MIDDLE * width, _RADIAL, _RADIAL])
    return Prior(first[list(LENS_NUMBERS)], sigma)


@dataclass(frozen=True, eq=False)
class Choice:
    """One way to take the lens, by plain least squares."""

    placed: Placed
    free: tuple[int, ...]
    prior: Prior | None
    left: LeftOut


def lens_choices(scene: Scene, begin: Placed, prior: Prior, intrinsics: FloatArray | None, lens: str) -> list[Choice]:
    """Return ways to take the lens: as given first; found, without distortion only where none is given, and with it.

    Args:
        scene: The images.
        begin: Where to begin.
        prior: Of the lens.
        intrinsics: As given, (9,); None where none are.
        lens: `found`: not as given.

    Raises:
        NotIdentifiableError: The images determine none.
    """
    result: list[Choice] = []
    if intrinsics is not None and lens != "found":
        placed, weights = plain(scene, begin, ())
        result.append(Choice(placed, (), None, predicted(scene, placed, (), weights, None)))
    for count in (6,) if intrinsics is not None else (4, 6):
        free = LENS_NUMBERS[:count]
        part = Prior(prior.values[:count], prior.sigma[:count])
        try:
            placed, weights = plain(scene, begin, free, part)
        except (ComputationError, np.linalg.LinAlgError):
            continue
        result.append(Choice(placed, free, part, predicted(scene, placed, free, weights, part)))
    if not result:
        plain(scene, begin, ())  # says what the images do not determine
        raise NotIdentifiableError("the photographs do not determine the lens; give intrinsics (--camera FILE)")
    return result

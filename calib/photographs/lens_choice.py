"""Choices for the lens of a hand-eye calibration.

Left-out images show distortion badly, because the robot's errors are larger. Single images with a freely placed board
show it well. If two numbers of distortion explain more of their residuals than chance does (an F test), a lens without
distortion is no choice.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import ComputationError, NotIdentifiableError
from calib.core.instruments.camera import NAMES
from calib.core.numerics.chances import FALSE_ALARM
from calib.photographs.camera_alone import camera_alone
from calib.photographs.estimation import HandEyeFit, plain
from calib.photographs.scene import POSES, BoardScene, HandEyePlacement, HandEyeUnknowns

LENSES = ("auto", "given", "found")
LENS_NUMBERS = tuple(NAMES.index(name) for name in ("fx", "fy", "cx", "cy", "k1", "k2"))
_FOCAL, _MIDDLE, _RADIAL = 0.1, 0.05, 0.5  # prior sigmas: parts of the focal length and of the width; k1 and k2
_FROM_MIDDLE = 0.12  # largest distance of a principal point from the middle of the image, as part of its width
_MOST_ASPECT = 1.25  # largest ratio of fx and fy


def unlikely(given: FloatArray, size: tuple[int, int]) -> list[tuple[str, str]]:
    """Return reasons (code, words) why given intrinsics, (9,), fit no lens for images of a size."""
    width, height = size
    middle, result = np.array([(width - 1) / 2, (height - 1) / 2]), []
    away = float(np.max(np.abs(given[2:4] - middle)))
    if away > _FROM_MIDDLE * max(width, height):
        exchanged = float(np.max(np.abs(given[3:1:-1] - middle))) < away / 2
        text = (
            f"the principal point given, {given[2]:.0f}, {given[3]:.0f} px, is far from the middle of images of {width}"
            f" x {height} px: {'cx and cy are exchanged' if exchanged else 'the intrinsics are of another image'}, or"
            " the images were turned, cut or scaled since"
        )
        result.append(("principal_point", text))
    if not 1 / _MOST_ASPECT < given[0] / given[1] < _MOST_ASPECT:
        text = f"fx and fy as given differ ({given[0]:.0f} and {given[1]:.0f} px): one of them is wrong"
        result.append(("focal", text))
    return result


def free_lens(first: FloatArray, scene: BoardScene, given: bool, count: int = len(LENS_NUMBERS)) -> HandEyeUnknowns:
    """Return `count` numbers of the lens as unknowns, expected near first intrinsics, (9,).

    Their prior is so wide that images decide where they can.
    """
    width = float(max(scene.size))
    focal = (_FOCAL if given else 1.0) * first[0]
    sigma = np.array([focal, focal, _MIDDLE * width, _MIDDLE * width, _RADIAL, _RADIAL])
    free = LENS_NUMBERS[:count]
    return HandEyeUnknowns(free, first[list(free)], sigma[:count])


def lens_choices(
    scene: BoardScene, begin: HandEyePlacement, first: FloatArray, intrinsics: FloatArray | None, lens: str
) -> list[HandEyeFit]:
    """Return fits of choices for the lens: intrinsics (9,) as given, then with distortion from `first` ones, (9,).

    A fit without distortion is a choice too if no lens is given and single images show no distortion.

    Raises:
        NotIdentifiableError: The images do not determine the lens of any choice.
    """
    result: list[HandEyeFit] = []
    if intrinsics is not None and lens != "found":
        result.append(plain(scene, replace(begin, intrinsics=intrinsics), POSES))
    for count in (6,) if intrinsics is not None or _is_distorted(scene, begin.intrinsics) else (4, 6):
        with suppress(ComputationError, np.linalg.LinAlgError):
            result.append(plain(scene, begin, free_lens(first, scene, first is intrinsics, count)))
    if not result:
        plain(scene, begin)  # raises an error that names the undetermined unknowns
        raise NotIdentifiableError("the photographs do not determine the lens; give intrinsics (--camera FILE)")
    return result


def _is_distorted(scene: BoardScene, first: FloatArray) -> bool:
    """Whether single images show more distortion than chance does; `first` are first intrinsics, (9,)."""
    squares = []
    for count in (4, 6):
        lengths = np.sum(camera_alone(scene, first, LENS_NUMBERS[:count]) ** 2, axis=1)
        known = np.isfinite(lengths)
        squares.append(float(np.sum(lengths[known])))
    freedom = 2 * np.count_nonzero(known) - 6 * len(np.unique(scene.image[known])) - 6
    if not (freedom > 0 and squares[1] > 0):
        return False
    ratio = (squares[0] - squares[1]) / 2 / (squares[1] / freedom)
    return bool(scipy.special.fdtrc(2, freedom, max(ratio, 0.0)) < FALSE_ALARM)

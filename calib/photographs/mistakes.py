"""Mistakes that would explain the residuals of a hand-eye calibration.

    other readings         of the file's numbers (`other_readings`)
    square size            the board is larger or smaller than described: fitted as a further unknown
    exchanged              camera and board are where the other mount and inverted poses put them
    something moved        board or camera is elsewhere from some image on: fitted as six further unknowns
    lens as given          fitted intrinsics contradict the given ones
    principal point        far from the middle of the image: of another or a turned image (`choices.unlikely`)

Other readings, and another size of the board, are solved anew from closed forms if an image is further off than robots
are; they count if they halve the residuals. Square size and moves are a further step of the same least squares; they
count if they raise the likelihood by more than chance does in one data set of ten thousand, and if their size matters.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import CalibrationError
from calib.core.base.units import quantity_text
from calib.core.instruments.camera import NAMES
from calib.core.numerics.identifiability import extend_reduced
from calib.core.numerics.linear_model import LinearModel
from calib.photographs.camera_alone import camera_alone
from calib.photographs.choices import free_lens, unlikely
from calib.photographs.estimation import HandEyeEstimate, estimate, left_out_errors, plain, rms, solve
from calib.photographs.robot_errors import ErrorSizes, ImageRows
from calib.photographs.scene import OTHER, SIDES, BoardScene, HandEyePlacement, Mount, residuals
from calib.photographs.starts import Start, start

_SHIFTS = (1, -1, 2, -2)
_FEWEST = 4  # images
_UNITS = (10.0, 0.1, 1000.0, 0.001)


def other_readings(scene: BoardScene, mounts: tuple[Mount, ...]) -> Iterator[tuple[str, str, BoardScene]]:
    """Yield code and words of a usual mistake in files, and the scene with that other meaning of its numbers."""
    n = len(scene)
    for shift in _SHIFTS:
        pairs = np.arange(n) + shift
        paired = (pairs >= 0) & (pairs < n)
        if np.sum(paired) < _FEWEST:
            continue
        tool = scene.tool.copy()
        tool[paired] = scene.tool[pairs[paired]]
        rows = "row" if abs(shift) == 1 else "rows"
        text = (
            f"images and poses are shifted: each image fits the pose {abs(shift)} {rows}"
            f" {'further on' if shift > 0 else 'before'}"
        )
        yield "pairs_shifted", text, replace(scene, tool=tool).select_images(paired)
    mirrored = replace(scene, pixels=scene.pixels * [-1, 1] + [scene.size[0] - 1, 0])
    yield "mirrored", "the images are mirrored; flip them, or switch that off in the camera", mirrored
    if len(mounts) == 1:  # with the other mount, the same images fit as well
        text = "the poses are inverted: the base in the tool, not the tool in the base"
        yield "poses_inverted", text, replace(scene, tool=np.linalg.inv(scene.tool))
    for text, tool in _other_rotations(scene.tool):
        yield "rotations", text, replace(scene, tool=tool)
    for factor in _UNITS:
        text = (
            f"the board would be {factor:.4g} times as large as described: lengths of the board or of the poses are in"
            f" another unit than the files say"
        )
        yield "units", text, replace(scene, body=factor * scene.body)


def _other_rotations(tool: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Yield a mistake in the rotations in words, and the corrected tool poses, (n, 4, 4).

    A rotation is converted back to the numbers of the file, which are then read in another way.
    """
    of = scipy.spatial.transform.Rotation
    read = of.from_matrix(tool[:, :3, :3])
    quaternions, angles = read.as_quat(), read.as_euler("xyz")
    ways = {
        "the rotations are inverted: of the base in the tool, while positions are of the tool in the base": read.inv(),
        "the quaternions have their real part first: name their columns qw, qx, qy, qz": of.from_quat(
            np.roll(quaternions, -1, axis=1)
        ),
        "the quaternions have their real part last: name their columns qx, qy, qz, qw": of.from_quat(
            np.roll(quaternions, 1, axis=1)
        ),
        "the angles turn about x, the new y and the new z, but were read about the fixed x, y and z (the same as about"
        " z, the new y and the new x): give quaternions": of.from_euler("XYZ", angles),
        "the first angle is about z, and the last about x: exchange the names of their columns": of.from_euler(
            "xyz", angles[:, ::-1]
        ),
    }
    for text, rotation in ways.items():
        other = tool.copy()
        other[:, :3, :3] = rotation.as_matrix()
        yield text, other


_UNKNOWN = "not_explained"
_FAR_PIXELS = 4.0
_HALVES = 0.5
_SURE = 0.1  # no other reading is tried if the relative residual is less
_BETTER = 0.6  # largest ratio of squared errors of left-out images, after and before
_CHANCE = 1e-4
_SCALE = 0.004  # least relevant relative error of a board's size
_SCALE_OFF = 0.02  # the same if images are further off than robots are
_MOVED = 1e-3  # least relevant shift [m]; the turn below is in rad
_TURNED = np.deg2rad(0.15)
_OTHER_UNIT = 2.0  # no print is this many times as large as described, or as small
_EXCHANGED = 1.5  # distance of what is on the tool over that of what is on the base, if they are exchanged
_LENS_OFF = 6.0  # standard deviations by which a number of the lens is certainly wrong
_ALSO_OFF = 3.0  # standard deviations that suffice if another number is certainly wrong
_SAME_LENS = 0.05  # intrinsics agree after an exchange if they differ by less than this part of the focal length
_SWAPS = {
    "cx and cy are exchanged": (0, 1, 3, 2),
    "fx and cx are exchanged": (2, 1, 0, 3),
    "fy and cy are exchanged": (0, 3, 2, 1),
    "fx and cx are exchanged, and fy and cy": (2, 3, 0, 1),
    "fx and cy are exchanged": (3, 1, 2, 0),
    "fy and cx are exchanged": (0, 2, 1, 3),
}
"""Index in the given numbers of each of fx, fy, cx, cy."""


@dataclass(frozen=True)
class Mistake:
    """A mistake that would explain the residuals.

    Attributes:
        code: Code such as `pairs_shifted`.
        text: The mistake, its size, and the remedy, in words.
        whole: Whether it spoils the whole result.
    """

    code: str
    text: str
    whole: bool = False


def find_mistakes(
    every: BoardScene,
    fitted: HandEyeEstimate,
    given: FloatArray | None,
    first: FloatArray,
    better: HandEyeEstimate,
    mounts: tuple[Mount, ...],
) -> tuple[Mistake, ...]:
    """Return mistakes that would explain the residuals, those that spoil the whole result first.

    Of `every` image, some are `fitted`; `better` has a fitted lens if that predicts left-out images better.
    Intrinsics as `given` and the `first` ones are (9,).
    """
    lens = _mistakes_of_lens(fitted, better, given)
    result = [] if any(mistake.whole for mistake in lens) else _mistakes_of_whole(every, fitted, first, mounts)
    if [mistake.code for mistake in result] == [_UNKNOWN]:
        moved = _check_move(fitted)
        result = result if moved is None else [replace(moved, whole=True)]
    if not any(mistake.whole for mistake in lens + result):
        exchanged = _check_exchange(fitted.placed, fitted.scene.mount) if len(mounts) > 1 else None
        likely = (_square_size(fitted), _check_move(fitted), exchanged)
        result += [mistake for mistake in likely if mistake is not None]
    return tuple(sorted(result + lens, key=lambda mistake: not mistake.whole))


def _mistakes_of_whole(
    scene: BoardScene, fitted: HandEyeEstimate, intrinsics: FloatArray, mounts: tuple[Mount, ...]
) -> list[Mistake]:
    typical = float(np.median(scene.rms_by_image(residuals(scene, fitted.placed))))
    if not typical > _FAR_PIXELS:
        return []
    alone = float(np.nan_to_num(rms(camera_alone(scene, intrinsics))))
    if not typical > 4 * alone:
        return []
    ends: list[tuple[float, str, str]] = []
    for code, text, other in other_readings(scene, mounts):
        try:
            begun = start(other, intrinsics, mounts=mounts)
        except (CalibrationError, np.linalg.LinAlgError):
            continue
        ends.append((begun.typical, code, text))
        if begun.typical < _SURE * typical:
            break
    least, code, text = min([*ends, *_other_size(scene, fitted)], default=(np.inf, "", ""))
    if least < _HALVES * typical:
        return [Mistake(code, f"{text} (then {least:.1f} px are left in place of {typical:.1f})", True)]
    text = (
        f"images are off by {typical:.0f} px, and the camera alone leaves {alone:.1f}: poses and images do not belong"
        " together, or the tool of the poses, the units or the order of rotations are not what the file says"
    )
    return [Mistake(_UNKNOWN, text, True)]


def _other_size(scene: BoardScene, fitted: HandEyeEstimate) -> Iterator[tuple[float, str, str]]:
    """Median RMS of the images with a fitted size of the board [px], the code and the words, if it is plausible."""
    try:
        unknowns = replace(free_lens(fitted.placed.intrinsics, scene, True), scaled=True)
        placed = solve(scene, fitted.placed, unknowns, ErrorSizes())
    except (CalibrationError, np.linalg.LinAlgError):
        return
    change = placed.scale - 1.0
    if abs(change) < _SCALE_OFF or not 1 / _OTHER_UNIT < placed.scale < _OTHER_UNIT:
        return
    text = (
        f"the board is {100 * abs(change):.0f} % {'larger' if change > 0 else 'smaller'} than described: measure its"
        " squares or markers, and correct its sizes"
    )
    yield Start(scene, placed).typical, "square_size", text


def _check_exchange(placed: HandEyePlacement, mount: Mount) -> Mistake | None:
    """The mistake of inverted poses with the other mount, if camera and board are where it would put them."""
    far = {name: float(np.linalg.norm(getattr(placed, name)[:3, 3])) for name in ("camera", "board")}
    on_tool, on_base = ("camera", "board") if mount == "tool" else ("board", "camera")
    if not far[on_tool] > _EXCHANGED * far[on_base]:
        return None
    return Mistake(
        "exchanged",
        f"the {on_tool} would be {far[on_tool]:.2f} m from the tool, and the {on_base} {far[on_base]:.2f} m from the"
        f" base: if the camera is {SIDES[OTHER[mount]]}, the poses are inverted (the base in the tool); if it is"
        f" {SIDES[mount]}, say so: --camera-on {mount}",
    )


def _square_size(fitted: HandEyeEstimate) -> Mistake | None:
    """The mistake of another board size than described, if likely."""
    try:
        other = estimate(plain(fitted.scene, fitted.placed, replace(fitted.unknowns, scaled=True)))
    except (CalibrationError, np.linalg.LinAlgError):
        return None
    std, change = float(np.sqrt(other.covariance[-1, -1])), other.placed.scale - 1.0
    chance = 2 * float(scipy.special.stdtr(other.freedom[-1], -abs(change) / std))
    if abs(change) < _SCALE or chance > _CHANCE:
        return None
    before, after = (rms(fit.left_out.pixels) ** 2 for fit in (fitted, other))
    if not after < _BETTER * before:
        return None
    return Mistake(
        "square_size",
        f"the board is {100 * abs(change):.1f} % {'larger' if change > 0 else 'smaller'} than described (±"
        f" {100 * std:.1f} %): measure it, and correct its sizes; printers shrink pages that they fit to paper",
    )


def _check_move(fitted: HandEyeEstimate) -> Mistake | None:
    """The mistake of a board or camera that moved after some image, if likely."""
    n, rows = len(fitted.scene), fitted.rows
    if n < 8:
        return None

    def wider(move: tuple[str, int]) -> ImageRows:
        """The rows with six further unknowns, a step in later images."""
        which, k = move
        columns = rows.pixels.jacobian[:, 6:12] if which == "board" else rows.pixels.jacobian[:, :6]
        return rows.with_columns(columns * (rows.image >= k)[:, None])

    moves = [(which, k) for which in ("board", "camera") for k in range(3, n - 2)]
    which, k = best = min(moves, key=lambda move: _least_cost(wider(move).weigh(fitted.noise)))
    most = wider(best)
    noise = ErrorSizes.from_model(most.find_sizes())
    model = most.weigh(noise)
    gained = max(_least_cost(rows.weigh(noise)) - _least_cost(model), 0.0)
    step = fitted.unknowns.scales[:6] * model.step()[-6:]
    moved, turned = float(np.linalg.norm(step[:3])), float(np.linalg.norm(step[3:]))
    chance = len(moves) * float(scipy.special.fdtrc(6, 6 * n - len(model.deviations), gained / 6))
    before, after = (float(np.sum(left_out_errors(each, fitted.weights) ** 2)) for each in (rows, most))
    if chance > _CHANCE or (moved < _MOVED and turned < _TURNED) or not after < _BETTER * before:
        return None
    return Mistake(
        "moved",
        f"the {which} moved before image {fitted.scene.names[k]}, by {quantity_text(moved, 'mm', '.1f')} and"
        f" {quantity_text(turned, 'deg', '.2f')}:"
        " fix it, and take the images again (or calibrate twice: with the images before, and with those after)",
    )


def _least_cost(model: LinearModel) -> float:
    """Cost of a linear model at its minimum."""
    prior = model.prior
    return float(extend_reduced(model.factor, prior.rows, prior.times(model.deviations))[-1, -1] ** 2)


def _mistakes_of_lens(fitted: HandEyeEstimate, better: HandEyeEstimate, given: FloatArray | None) -> list[Mistake]:
    """Mistakes in given intrinsics, (9,): implausible values, and contradictions to the photographs."""
    if given is None:
        return []
    free = list(better.unknowns.free)
    swap = _swapped_numbers(given, better) if free else ""
    result = [] if swap else [Mistake(code, text) for code, text in unlikely(given, fitted.scene.size)]
    if not free:
        return result
    kept = not fitted.unknowns.free  # the given intrinsics are used although others are better
    std = np.sqrt(np.diag(better.covariance)[better.unknowns.lens])
    change = (better.placed.intrinsics - given)[free]
    sure, pixels = np.abs(change) / std, np.abs(change[:4])
    # a relative error of the focal length is the same relative error of a distance
    if not (kept or swap or (np.max(sure) > _LENS_OFF and np.max(pixels) / better.placed.intrinsics[0] > 0.02)):
        return result
    numbers: list[str] = []
    for k in dict.fromkeys((int(np.argmax(sure)), int(np.argmax(np.where(sure[:4] > _ALSO_OFF, pixels, 0.0))))):
        if numbers and not sure[k] > _ALSO_OFF:
            continue
        number, digits = free[k], 1 if free[k] < 4 else 4  # for px, else for distortion
        numbers.append(
            f"{NAMES[number]} is given as {given[number]:.{digits}f}, and found as"
            f" {better.placed.intrinsics[number]:.{digits}f} ± {std[k]:.{digits}f}"
        )
    before, after = (Start(fitted.scene, each.placed).typical for each in (fitted, better))
    text = f"the intrinsics given contradict the photographs: {', '.join(numbers)}{f' ({swap})' if swap else ''}; " + (
        "let them be found (leave out --lens given)" if kept else "those found are used"
    )
    return [*result, Mistake("lens_given", text, before > _FAR_PIXELS and after < _HALVES * before)]


def _swapped_numbers(given: FloatArray, better: HandEyeEstimate) -> str:
    """The exchange of given intrinsics, (9,), that explains the fitted ones, in words; empty if none does."""
    real = better.placed.intrinsics[:4]
    off = {words: float(np.max(np.abs(given[list(swap)] - real))) / real[0] for words, swap in _SWAPS.items()}
    words = min(off, key=lambda swap: off[swap])
    as_it_is = float(np.max(np.abs(given[:4] - real))) / real[0]
    return words if off[words] < min(_SAME_LENS, as_it_is / 2) else ""

"""Joint values of a robot: spread evenly, or drawn at random within joint limits where the robot can reach them.

Evenly: the same points however the robot is described. The coordinates of a Halton point are unlike each other. The
robot at home decides which joint gets which: joints are sorted by their distance from the base, then by how they move
the targets; and the motion of the targets decides which end of a joint's range is the lower one. So names and order of
joints do not count, nor which direction of an axis is called positive. The motion is compared along skew directions
that no robot's axes have, so that rounding decides nothing.

At random: a closed-loop robot can reach only a part of the box of its joint limits, sometimes a small one. Therefore
the box is shrunk towards home, by a third each time, until enough of the values in it are usable. Where targets must
stay in a range, the box is not shrunk, since home may be outside of the range; values are tried until enough are
usable.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.errors import DataError, InputError, require_known
from calib.core.base.words import listing, warn_once
from calib.core.numerics.halton import halton
from calib.core.robots.closure import AssemblyMode, motion
from calib.core.robots.mechanism import Mechanism
from calib.core.robots.urdf.text import UrdfText

Ranges = Mapping[str, tuple[float, float]]
"""Lower and upper limit, by name of a joint or of a coordinate of a target such as `tool_x` [SI]."""
TRIES = 4
"""Number of values tried in each box, for each requested value."""
_DRAWN_IN = 2.0 / 3.0
_SMALLEST_BOX = 0.01  # size of the smallest box, as part of the joint limits
_ROUNDS = 50  # rounds of trials where targets must stay in a range
_AT_ONCE = 2**15  # values tried at once
_LONGEST = 1e3  # stroke of a sliding joint [m]
_MOST_TURNS = 10
_DIRECTIONS = np.array([0.083, 0.131, 0.179, 0.777, 1.139, 1.621])  # directions of velocities and turns of a target


def joint_samples(mode: AssemblyMode, count: int) -> FloatArray:
    """Return points for the home of a nominal robot, (count, n_driven), from 0 to 1; the first is a corner."""
    mechanism = mode.mechanism
    moved = np.zeros(len(mechanism.driven))
    for target in mechanism.targets:  # seen from the base's link, wherever the measurement frame is
        seen = replace(target, a=mechanism.model.parents[target.a])
        jacobian = motion(mechanism, seen, mode.actuated[None], mode.passive[None])[2][0]
        moved += _DIRECTIONS / np.repeat([mechanism.length, 1.0], 3) @ jacobian * mechanism.driven_scale
    n_actuated = len(mechanism.actuated)
    order = np.arange(len(moved))  # tilts of links come last
    order[:n_actuated] = np.lexsort((np.abs(moved[:n_actuated]), mechanism.depths))
    samples = np.empty((count, len(moved)))
    samples[:, order] = halton(count, len(moved))
    return np.where(moved < 0, 1 - samples, samples)


def validate_ranges(within: Ranges, known: Sequence[str]) -> Ranges:
    """Return the ranges; raise `InputError` for an unknown name or a range that is not valid."""
    for name, span in within.items():
        require_known(name, known, "within: no joint or coordinate")
        if np.shape(span) != (2,):
            raise InputError(f"within: {name} needs a range, such as (-0.5, 0.5)")
        low, high = span
        if not (np.isfinite(low) and np.isfinite(high) and low <= high):
            raise InputError(f"within: {name} from {low:g} to {high:g} is not a range; give the smaller number first")
    return within


def joint_box(
    mechanism: Mechanism, urdf: UrdfText, home: FloatArray, ranges: Ranges, path: str
) -> tuple[FloatArray, FloatArray]:
    """Return lower and upper joint limits, (n_actuated,) each [m or rad].

    A turning joint without limits, or with very wide ones, gets half a turn to each side of `home` (n_actuated,).
    Joints with a range get this range, as far as it is inside their limits; one outside is an `InputError`. `DataError`
    if a prismatic joint has no limits, or the limits of a joint leave no room to move.
    """
    joints = {joint.name: joint for joint in urdf.joints}
    still = [name for name in mechanism.actuated if name not in ranges and not joints[name].moves]
    if still:
        raise DataError(
            f"{path}: no range to spread poses over for {listing(still)}: a <limit> without lower and upper is 0 to 0;"
            " write the limits into the URDF, give ranges (--within), or a file of poses"
        )
    lower, upper = home.copy(), home.copy()
    for k, name in enumerate(mechanism.actuated):
        low, high = joints[name].lower, joints[name].upper
        if name in ranges:
            lower[k], upper[k] = max(low, ranges[name][0]), min(high, ranges[name][1])
            if lower[k] > upper[k]:
                raise InputError(f"within: {name} lies outside its joint limits {low:.6g} to {high:.6g} [m or rad]")
            continue
        if mechanism.dimensions[name] == "length" and not high - low < _LONGEST:
            stated = f"limits as wide as {low:g} to {high:g} m" if np.isfinite(high - low) else "no limits"
            raise DataError(
                f"{path}: sliding joint '{name}' has {stated}; give a range to spread poses over (--within), or a file"
                " of poses"
            )
        if np.isfinite(high - low) and high - low > _MOST_TURNS * 2 * np.pi:
            turns = (high - low) / (2 * np.pi)
            warn_once(f"{path}: limits of '{name}' span {turns:.0f} turns; poses are spread over one, around home")
            low, high = -np.inf, np.inf
        lower[k] = low if np.isfinite(low) else min(home[k], high) - np.pi
        upper[k] = high if np.isfinite(high) else max(home[k], low) + np.pi
    return lower, upper


def draw_spread(
    count: int,
    rng: np.random.Generator,
    box: tuple[FloatArray, FloatArray],
    home: FloatArray,
    usable: Callable[[FloatArray], IntArray],
    *,
    draw_in: bool,
) -> FloatArray:
    """Return up to `count` random values in a box, (n, n_actuated) [m or rad]; fewer if too few are usable.

    Args:
        box: Lower and upper, (n_actuated,) each [m or rad].
        home: Centre towards which the box is shrunk, if `draw_in`, (n_actuated,) [m or rad].
        usable: Function that returns the indices of usable joint values among (n, n_actuated).
    """
    lower, upper = box
    middle = np.clip(home, lower, upper)
    samples: list[FloatArray] = []
    missing = count
    size, rounds = 1.0, 0
    while missing > 0 and size > _SMALLEST_BOX and rounds < _ROUNDS:
        low, high = middle + size * (lower - middle), middle + size * (upper - middle)
        left = TRIES * count
        while missing > 0 and left > 0:  # a part at a time: the same numbers, and no more memory than the result needs
            q = rng.uniform(low, high, (min(left, _AT_ONCE), len(low)))
            samples.append(q[usable(q)][:missing])
            left, missing = left - len(q), missing - len(samples[-1])
        size, rounds = (_DRAWN_IN * size, rounds) if draw_in else (size, rounds + 1)
    return np.vstack([np.zeros((0, len(home))), *samples])

"""Effects that a model may leave out, as columns: their parts of the whitened rows of a fit.

`calib.core.judging.effect_kinds` lists the kinds. Each is a derivative of `calib.core.judging.row_derivatives`, times
factors of each visit:

    drift, turning, growth,  Legendre polynomials of degree 1 to 3 of the course of the measurement: the time, where the
    zero                     data have it, and else the order of the rows. They explain 86 % of a sudden step
    joint                    the same of the joint's own value over the range measured: gear error, lead error, sag
    wave                     cosine and sine of 1 to 120 cycles a turn: the teeth of a gear, an encoder's lines
    coupling                 the value of a neighbouring joint: gears or belts on one shaft
    approach                 +-1, by the direction in which the joint moved last: half the backlash
    slip                     0, and 1 from one visit on
    all others               1 at each visit

Joints that never moved get no effects.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.memoize import memoize
from calib.core.base.words import count_noun
from calib.core.fitting.pose_checks import unmoved_joints
from calib.core.judging.effect_kinds import Kind
from calib.core.judging.row_derivatives import EffectSetting, constants, moved_targets, other_joints, own_scales, scales
from calib.core.robots.terms.periodic import TURN

ORDERS = range(1, 121)
"""Cycles of a wave in a turn of the joint, or over the range that a joint slides."""
SLIPS = 15
"""Number of places in the course of the measurement at which a slip of a target is tested."""
_SAME = 1e-6  # cycles that rounding may add
_ON_GRID = 0.99  # a wave of length 1 is the same at all visits if its mean is longer than this
_LIKELY, _VISITS_LOOKED_AT = 0.9, 32  # it may be if its mean over so many visits is longer than this


@dataclass(frozen=True, eq=False)
class Effects:
    """Effects of one kind on one thing; each adds B (x) F: every column of B times every factor of F.

    Attributes:
        name: Its axis, joint, target or instrument; `xyz` for all axes.
        base: B, change of the whitened rows, (n_rows, b).
        visit: Visit of each row, (n_rows,).
        by_visit: F of each effect at each visit, (n_visits, f, n_effects).
        details: Detail of each effect, as in `Pattern`.
        group: The group whose readings it changes; None: that of the positions.
    """

    kind: Kind
    name: str
    base: FloatArray
    visit: IntArray
    by_visit: FloatArray
    details: Sequence[str] = ("",)
    group: int | None = None

    def factors(self, visits: IntArray) -> FloatArray:
        """Return F of every effect at visits (n,), (n, f, n_effects)."""
        return self.by_visit[visits]

    def factors_of(self, number: int) -> FloatArray:
        """Return F of one effect at all visits, (n_visits, f)."""
        return self.by_visit[:, :, number]

    def detail(self, numbers: IntArray, gains: FloatArray, row: int, margin: float) -> str:
        """Return the detail of a row of the tested effects.

        Their `numbers` and `gains` are (n_tested,); noise may make gains differ by `margin`.
        """
        return self.details[numbers[row]]

    def columns(self, number: int) -> FloatArray:
        """Return all columns of one effect, (n_rows, b f)."""
        factors = self.factors_of(number)[self.visit]
        return (self.base[:, :, None] * factors[:, None, :]).reshape(len(self.base), -1)

    def times(self, number: int, coefficients: FloatArray) -> FloatArray:
        """Return the columns of one effect times coefficients (b f,), (n_rows,)."""
        weights = self.factors_of(number) @ coefficients.reshape(self.base.shape[1], -1).T
        return np.asarray(np.einsum("ij,ij->i", self.base, weights[self.visit]))


@dataclass(frozen=True, eq=False, kw_only=True)
class Waves(Effects):
    """The waves of one joint: cosine and sine of each of `orders` times a phase, `by_visit` (n_visits, 1, 1) [rad].

    Attributes:
        orders: Cycles of each effect.
        unit: What the cycles are counted in.
    """

    orders: range
    unit: str

    def factors(self, visits: IntArray) -> FloatArray:
        """Return cosine and sine of every order at visits (n,), (n, 2, n_orders)."""
        waves = powers(np.exp(1j * self.by_visit[visits, 0, 0]), self.orders.stop - 1)[self.orders.start - 1 :]
        return np.stack([waves.real, waves.imag]).transpose(2, 0, 1)

    def factors_of(self, number: int) -> FloatArray:
        """Return cosine and sine of one order at all visits, (n_visits, 2)."""
        angle = self.orders[number] * self.by_visit[:, 0]
        return np.concatenate([np.cos(angle), np.sin(angle)], axis=1)

    def detail(self, numbers: IntArray, gains: FloatArray, row: int, margin: float) -> str:
        """Return all numbers of cycles that explain the residuals as well, in words; see `Effects.detail`."""
        alike = numbers[gains > gains[row] - margin]
        first, last = self.orders[alike[0]], self.orders[alike[-1]]
        if first == last or (last - first == len(alike) - 1 and len(alike) < len(numbers)):
            return f"{'' if first == last else f'{first} to '}{count_noun(last, 'cycle')} {self.unit}"
        return f"a number of cycles {self.unit} that these poses do not determine"


def powers(turned: NDArray[np.complex128], count: int) -> NDArray[np.complex128]:
    """Return z, z^2, ... of complex numbers z (...), (count, ...)."""
    result = np.empty((count, *turned.shape), dtype=complex)
    result[0], known = turned, 1
    while known < count:
        more = min(known, count - known)
        np.multiply(result[:more], result[known - 1], out=result[known : known + more])
        known += more
    return result


def wave_orders(phases: FloatArray) -> list[range]:
    """Return the numbers of cycles to test for each joint with these phases of one cycle, (n_visits, n_joints) [rad].

    An order counts only if the joint went through half a cycle of it: otherwise its height is not known. If joint
    values lie on a grid (every 5 degrees), an order above half the grid's cycles in a turn (36) equals a lower one at
    all poses: only the lower one counts.
    """
    few = phases[:: len(phases) // _VISITS_LOOKED_AT + 1]
    common = np.abs(np.mean(powers(np.exp(1j * few), 2 * ORDERS.stop - 1), axis=1)) > _LIKELY
    orders = []
    for phase, same, reach in zip(phases.T, common.T, np.ptp(phases, axis=0).tolist(), strict=True):
        if reach == 0:
            orders.append(range(0))
            continue
        likely = np.flatnonzero(same)
        likely = likely[likely >= int(np.ceil(TURN / reach - _SAME)) - 1] + 1  # not less than one cycle
        grid = next((order for order in likely if abs(np.mean(np.exp(1j * order * phase))) > _ON_GRID), 2 * ORDERS.stop)
        stop = min(int(grid) // 2 + 1, ORDERS.stop)
        orders.append(range(min(int(np.ceil(TURN / 2 / reach - _SAME)), stop), stop))
    return orders


@memoize
def effects(setting: EffectSetting) -> tuple[Effects, ...]:
    """Return every effect."""
    every = (_frame_effects, _instrument_effects, _target_effects, _joint_effects)
    return tuple(effect for some in every for effect in some(setting))


def _frame_effects(setting: EffectSetting) -> Iterator[Effects]:
    shifts, turns = setting.frame_columns[:, :3], setting.frame_columns[:, 3:6]
    groups, visit = setting.fit.whitening.groups, setting.visit
    read = np.array([group.part.is_position or group.part.is_distance for group in groups])  # lengths themselves
    lengths = scales(setting)[:, :1] * read[setting.fit.whitening.layout.group][:, None]
    always, in_course = _always(setting), _curves(setting.course[:, None])
    for axis, name in enumerate("xyz"):
        yield Effects(Kind.AXIS, name, shifts[:, axis : axis + 1], visit, always)
    yield Effects(Kind.DRIFT, "xyz", shifts, visit, in_course)
    yield Effects(Kind.TURN, "xyz", turns, visit, always)
    yield Effects(Kind.TURNING, "xyz", turns, visit, in_course)
    yield Effects(Kind.SCALE, "xyz", lengths, visit, always)
    yield Effects(Kind.GROWTH, "xyz", lengths, visit, in_course)


def _instrument_effects(setting: EffectSetting) -> Iterator[Effects]:
    scaled, visit, always = own_scales(setting), setting.visit, _always(setting)
    for name, group, columns in constants(setting):
        yield Effects(Kind.OFFSET, name, columns, visit, always, group=group)
        if (name, group) in scaled:
            yield Effects(Kind.FACTOR, name, scaled[name, group], visit, always, group=group)


def _target_effects(setting: EffectSetting) -> Iterator[Effects]:
    """Targets that slip, at evenly spread visits, and targets that move with other links."""
    order = np.argsort(setting.course, kind="stable")
    firsts = np.unique(np.linspace(0, len(order), SLIPS + 2)[1:-1].astype(np.intp))
    late = (np.argsort(order)[:, None] >= firsts).astype(float)[:, None]
    slips = [f"from {setting.data.labels[order[first]]} on" for first in firsts]
    for target, (own, *others) in moved_targets(setting).items():
        for joint, moved in zip(other_joints(setting.fit.robot, target), others, strict=True):
            before = setting.fit.robot.mechanism.origin_names[joint - 1]
            yield Effects(Kind.LINK, target, moved, setting.visit, _always(setting), (before,))
        yield Effects(Kind.SLIP, target, own, setting.visit, late, slips)


def _joint_effects(setting: EffectSetting) -> Iterator[Effects]:
    robot, data, visit = setting.fit.robot, setting.data, setting.visit
    names, curves, in_course = robot.joint_names, _curves(data.joints), _curves(setting.course[:, None])
    still, driving = unmoved_joints(robot, data.joints), (np.mean(data.joints, axis=0) - data.joints)[:, None]
    turning = np.array([robot.mechanism.dimensions[name] == "angle" for name in names])
    reach = np.ptp(data.joints, axis=0)
    phases = data.joints * np.where(turning, 1.0, TURN / np.where(reach > 0, reach, 1.0))
    for j, (name, orders) in enumerate(zip(names, wave_orders(phases), strict=True)):
        if name in still:
            continue
        column = setting.joint_columns[:, j : j + 1]
        yield Effects(Kind.JOINT, name, column, visit, curves[:, :, j : j + 1])
        yield Effects(Kind.APPROACH, name, column, visit, data.approach_directions[:, j, None, None])
        yield Effects(Kind.ZERO, name, column, visit, in_course)
        drivers = [k for k in (j - 1, j + 1) if 0 <= k < len(names) and names[k] not in still]
        if drivers:
            yield Effects(Kind.COUPLING, name, column, visit, driving[:, :, drivers], [names[k] for k in drivers])
        if orders:
            unit = "a turn" if turning[j] else "over the range measured"
            yield Waves(Kind.WAVE, name, column, visit, phases[:, j, None, None], orders=orders, unit=unit)


def _always(setting: EffectSetting) -> FloatArray:
    return np.ones((len(setting.data), 1, 1))


def _curves(values: FloatArray) -> FloatArray:
    """Legendre polynomials of degree 1 to 3 over the ranges of values (n, k), as factors of k effects, (n, 3, k)."""
    reach = np.ptp(values, axis=0)
    x = 2 * (values - values.min(axis=0)) / np.where(reach > 0, reach, 1.0) - 1
    return np.stack([x, (3 * x**2 - 1) / 2, (5 * x**3 - 3 * x) / 2], axis=1)

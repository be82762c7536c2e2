"""Systematic residuals: patterns that are no noise.

Question. Would the model explain the data significantly better with one more effect? For an effect with columns Z (its
change of the measured rows) the linear model r = J du + Z c is compared with the fit:

    M = I - J A^-1 J^T,   A = J^T J + sigma^2 P        what of Z the fit has not absorbed already
    gain = r^T Z (Z^T M Z)^-1 Z^T r                    by how much |r|^2 would fall
    F = (gain / k) / ((|r|^2 - gain) / (nu - k))       against F(k, nu - k), k columns left after M

The effects are those of `calib.core.judging.effects`. An effect that the fit absorbs (a constant shift, where the base
is free) is invisible and not tested: `visible` gives the size at which it would show. Effects come in families of
kinds, which share the chance of a false finding evenly; in a family, the chance of each finding is multiplied by the
number of its tests. A finding needs a chance below 1 % over all families, and an effect of at least a tenth of the
noise: enough data make any trifle significant. Where poses scatter more than independent readings
(`calib.core.numerics.clusters`), F is divided by the excess scatter of the effect's score, summed pose by pose, and nu
is that of this scatter. A fit follows each pose a little, so that its residuals scatter too little. So a finding must
also hold with other residuals: those of each pose if fit and effect are found from all other poses. Of waves and of
slips, which are tried by the dozen for each joint or target, the best is kept.

The direction of approach and, without a time, the course of the measurement come from the order of the rows in the data
file, which must be the order of measurement.

Many effects at once. A test needs only Z^T Z, (J T)^T Z with the span J T of the fit, and Z^T r. The effects of a
joint, a target or a frame have the columns of one base times factors of each visit, such as sin(k q_i) and cos(k q_i)
of a wave. So the sums over the rows of a visit are computed once for each base and serve all its effects.

When it fails. Effects of other shapes stay in the noise; two effects that look alike at the measured poses are both
named. F supposes normal noise.

Reference: cook1982, chapter 2.4 (added variables), and 3 (residuals without the pose that is judged).
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, groupby

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.judging.effect_kinds import Family, Kind, Pattern, Trait
from calib.core.judging.effects import Effects, EffectSetting
from calib.core.judging.linear_fit import ABSORBED, LinearFit
from calib.core.numerics import linalg
from calib.core.numerics.chances import EXACT, FALSE_ALARM
from calib.core.numerics.tall import KEPT, slices

SMALLEST_EFFECT = 0.1
"""An effect counts as a finding if its root mean square is more than this part of the noise."""
_NUMBERS_AT_ONCE = 1 << 24  # largest size of the array of what findings explain
_VISITS_AT_ONCE = 512  # their factors stay in the processor's cache
_ALIKE = 9.2  # times the noise squared: chance makes a sine and cosine explain more in 1 % of cases


@dataclass(frozen=True, eq=False)
class _Moments:
    """Products of m effects with k columns Z each, for their tests.

    Attributes:
        squares: Z^T Z, (m, k, k).
        absorbed: (J T)^T Z, (m, rank, k).
        score: Z^T r, (m, k).
    """

    effects: Effects
    squares: FloatArray
    absorbed: FloatArray
    score: FloatArray


@dataclass(frozen=True, eq=False)
class _EffectTests:
    """Results of the tests of m effects with k columns each.

    Attributes:
        effects: Effects of one kind and name.
        numbers: Their numbers, (m,).
        p_values: Chance of such a gain if readings are independent, (m,).
        ratios: F of the module docstring, (m,).
        ranks: Columns left after M, (m,).
        gains: Decrease of |r|^2, (m,).
        coefficients: c, (m, k).
        absorbed: (J T)^T Z, (m, rank, k).
    """

    effects: Effects
    numbers: IntArray
    p_values: FloatArray
    ratios: FloatArray
    ranks: IntArray
    gains: FloatArray
    coefficients: FloatArray
    absorbed: FloatArray

    def best(self) -> int:
        """Return the row of the most significant effect, with the largest gain among equals."""
        return int(np.lexsort((-self.gains, self.p_values))[0])

    def detail(self, row: int, margin: float) -> str:
        """Return the detail of an effect; for a wave all numbers of cycles that explain the residuals as well.

        Args:
            row: The effect.
            margin: Difference of gains in |r|^2 that noise could have caused.
        """
        details = self.effects.details
        detail = details[self.numbers[row]]
        if self.effects.kind is not Kind.WAVE:
            return detail
        alike = self.numbers[self.gains > self.gains[row] - margin]
        if len(alike) < 2:
            return detail
        first, _, unit = details[alike[0]].partition(" ")
        if alike[-1] - alike[0] == len(alike) - 1 and len(alike) < len(self.numbers):
            return f"{first} to {details[alike[-1]]}"
        return f"a number of {unit} that these poses do not determine"


def patterns(residuals: LinearFit, setting: EffectSetting, kinds: Container[Kind] = tuple(Kind)) -> tuple[Pattern, ...]:
    """Return the results of testing effects of some kinds, most significant first."""
    if residuals.factor * setting.noise_of(setting.first) < EXACT:
        return ()
    tested = _tests(residuals, [effect for effect in setting.effects if effect.kind in kinds])
    times = dict.fromkeys(Family, 0)
    for tests in tested:
        times[tests.effects.kind.family] += len(Family) * len(tests.numbers)
    kept = _kept(tested)
    noise = setting.sizes(np.full((len(residuals.span), 1), residuals.factor))[:, 0]
    result = []
    for part in slices(len(kept), max(_NUMBERS_AT_ONCE // len(residuals.span), 1)):
        explained = _effects_with_residuals(residuals, kept[part])
        for (tests, row), column, sizes in zip(kept[part], explained.T, setting.sizes(explained).T, strict=True):
            group = setting.first if tests.effects.group is None else tests.effects.group
            size, dimension = float(sizes[group]), setting.fit.whitening.groups[group].part.dimension
            kind, c = tests.effects.kind, tests.coefficients[row]
            p = min(1.0, _chance(residuals, tests, row, column, FALSE_ALARM / times[kind.family]) * times[kind.family])
            dozen = Trait.BY_THE_DOZEN in kind.traits
            amount = float(np.linalg.norm(c)) if dozen else float(c[0]) if len(c) == 1 else float("nan")
            surely = p < FALSE_ALARM and size > SMALLEST_EFFECT * noise[group]
            detail = tests.detail(row, _ALIKE * residuals.factor**2)
            result.append(Pattern(kind, tests.effects.name, p, size, amount, surely, dimension, detail))
    return tuple(sorted(result, key=lambda pattern: (pattern.p_value, -pattern.size)))


def _kept(tested: Iterable[_EffectTests]) -> list[tuple[_EffectTests, int]]:
    """Keep the most significant effect of each name of kinds that are tried by the dozen, and all of the others."""
    kept: dict[tuple[Kind, str, int], tuple[_EffectTests, int]] = {}
    for tests in tested:
        kind, name = tests.effects.kind, tests.effects.name
        if Trait.BY_THE_DOZEN not in kind.traits:
            kept |= {(kind, name, len(kept) + row): (tests, row) for row in range(len(tests.numbers))}
            continue
        row, (other, best) = tests.best(), kept.get((kind, name, -1), (None, 0))
        new = tests.p_values[row], -tests.gains[row]
        if other is None or new < (other.p_values[best], -other.gains[best]):
            kept[kind, name, -1] = tests, row
    return list(kept.values())


def _effects_with_residuals(residuals: LinearFit, kept: Sequence[tuple[_EffectTests, int]]) -> FloatArray:
    """Return M Z c of each effect, (n_rows, n_effects), which takes less time for several than `after_fit`."""
    absorbed = np.stack([tests.absorbed[row] @ tests.coefficients[row] for tests, row in kept], axis=1)
    whole = [tests.effects.times(int(tests.numbers[row]), tests.coefficients[row]) for tests, row in kept]
    return np.asarray(np.stack(whole, axis=1) - residuals.span.times(absorbed))


def _moments(residuals: LinearFit, some: list[Effects]) -> Iterator[_Moments]:
    """Yield the moments of effects with one base; see the module docstring."""
    base, span = some[0].base, residuals.span
    tall = len(span) > KEPT  # then J T is not stored: it is computed from sums over rows
    known = [span[:]] if not tall else [span.jacobian] if span.more is None else [span.jacobian, span.more]
    others = [base, residuals.rows.residuals[:, None], *known]
    b, n, width = base.shape[1], len(span.root), sum(other.shape[1] for other in others)
    shapes = [effect.factors(some[0].visit[:1]).shape[1:] for effect in some]
    squares = [np.zeros((m, b * f, b * f)) for m, f in shapes]
    products = np.zeros((b, width, sum(m * f for m, f in shapes)))
    constant = len(some) == 1 and type(some[0]) is Effects and some[0].by_visit is None
    if constant:  # no sums of visits: several times as fast
        squares[0] += base.T @ base
        products += np.hstack([base.T @ other for other in others])[:, :, None]
    for rows, firsts, visits in () if constant else _visits_together(some[0].visit):
        sums = _sums_of_visits(base[rows], [other[rows] for other in others], firsts)
        factors = [effect.factors(visits) for effect in some]
        for square, each in zip(squares, factors, strict=True):
            square += _squares(sums[:, :, :b], each)
        columns = np.hstack([each.reshape(len(visits), -1) for each in factors])
        products += (sums.reshape(len(visits), -1).T @ columns).reshape(products.shape)
    first = 0
    for effect, square, (m, f) in zip(some, squares, shapes, strict=True):
        each = products[:, b:, first : first + m * f].reshape(b, width - b, m, f)
        own, first = each.transpose(2, 1, 0, 3).reshape(m, width - b, b * f), first + m * f
        score, absorbed = own[:, 0], own[:, 1:]
        if tall:
            absorbed = np.concatenate([span.root.T @ absorbed[:, :n], absorbed[:, n:]], axis=1)
        yield _Moments(effect, square, absorbed, score)


def _squares(sums: FloatArray, factors: FloatArray) -> FloatArray:
    """Return Z^T Z of each effect, (m, b f, b f), from B^T B of visits (n, b, b) and factors (n, m, f)."""
    (n, m, f), b = factors.shape, sums.shape[1]
    flat, whole = sums.reshape(n, -1).T, np.empty((b, b, m, f, f))
    for i, j in combinations_with_replacement(range(f), 2):
        whole[..., i, j] = (flat @ (factors[:, :, i] * factors[:, :, j])).reshape(b, b, m)
        whole[..., j, i] = whole[..., i, j]
    return whole.transpose(2, 0, 3, 1, 4).reshape(m, b * f, b * f)


def _visits_together(visit: IntArray) -> Iterator[tuple[IntArray | slice, IntArray, IntArray]]:
    """Yield rows of some visits, those of a visit together; where each of these begins among them, and the visits."""
    order: IntArray | None = None if np.all(visit[1:] >= visit[:-1]) else np.argsort(visit, kind="stable")
    arranged = visit if order is None else visit[order]
    firsts = np.flatnonzero(np.append(True, arranged[1:] != arranged[:-1]))
    for k in range(0, len(firsts), _VISITS_AT_ONCE):
        some = firsts[k : k + _VISITS_AT_ONCE]
        last = firsts[k + _VISITS_AT_ONCE] if k + _VISITS_AT_ONCE < len(firsts) else len(visit)
        rows = slice(int(some[0]), int(last))
        yield rows if order is None else order[rows], some - some[0], arranged[some]


def _sums_of_visits(base: FloatArray, others: list[FloatArray], firsts: IntArray) -> FloatArray:
    """Return B^T times others, summed over the rows of each visit, (n_visits, b, k).

    Args:
        base: B of rows of visits, one visit after the other, (n, b).
        others: Arrays of these rows, (n, ...) each, k columns together.
        firsts: First row of each visit, (n_visits,).
    """
    n_visits, length = len(firsts), len(base) // len(firsts)
    if n_visits * length == len(base) and np.array_equal(firsts, length * np.arange(n_visits)):
        each = base.reshape(n_visits, length, -1).transpose(0, 2, 1)  # without the products: a tenth of the time
        return np.concatenate([np.matmul(each, other.reshape(n_visits, length, -1)) for other in others], axis=2)
    return np.asarray(np.add.reduceat(base[:, :, None] * np.hstack(others)[:, None, :], firsts))


def _tests(residuals: LinearFit, some: list[Effects]) -> list[_EffectTests]:
    """Test the visible effects, all with equally many columns at once; those of one base stand together."""
    groups = [list(members) for _, members in groupby(some, key=lambda effect: id(effect.base))]
    by_width: dict[int, list[_Moments]] = {}
    for moments in (moments for group in groups for moments in _moments(residuals, group)):
        by_width.setdefault(moments.score.shape[1], []).append(moments)
    return [tests for alike in by_width.values() for tests in _tests_at_once(residuals, alike)]


def _tests_at_once(residuals: LinearFit, some: list[_Moments]) -> list[_EffectTests]:
    """Test effects with equally many columns, without absorbed ones and those that leave no degree of freedom."""
    squares, inside, scores = (
        np.concatenate([getattr(moments, name) for moments in some]) for name in ("squares", "absorbed", "score")
    )
    size = np.sqrt(np.diagonal(squares, axis1=1, axis2=2))
    shown = np.all(size > 0, axis=1)
    size = np.where(shown[:, None], size, 1.0)
    absorbed = inside / size[:, None, :]
    left = squares / (size[:, :, None] * size[:, None, :]) - np.matmul(absorbed.transpose(0, 2, 1), absorbed)
    values, vectors = linalg.eigh(left)
    determined = values > ABSORBED
    score = np.where(determined, np.matmul((scores / size)[:, None, :], vectors)[:, 0], 0.0)
    along = score / np.where(determined, values, 1.0)
    gains, k = np.sum(score * along, axis=1), np.sum(determined, axis=1)
    coefficients = np.matmul(vectors, along[:, :, None])[:, :, 0] / size
    rows = np.flatnonzero(shown & (k > 0) & (residuals.freedom - k >= 1))
    k, freedom_left, gains = k[rows], residuals.freedom - k[rows], gains[rows]
    rest = np.maximum(residuals.square - gains, 1e-12 * residuals.square) / freedom_left
    ratios = np.maximum(gains / k / rest, 0.0)
    found = (scipy.special.fdtrc(k, freedom_left, ratios), ratios, k, gains, coefficients[rows], inside[rows])
    ends = np.cumsum([len(moments.score) for moments in some])
    tested = []
    for moments, end in zip(some, ends.tolist(), strict=True):
        first = end - len(moments.score)
        own = slice(*np.searchsorted(rows, (first, end)).tolist())
        if own.start < own.stop:
            tested.append(_EffectTests(moments.effects, rows[own] - first, *(array[own] for array in found)))
    return tested


def _chance(residuals: LinearFit, tests: _EffectTests, row: int, explained: FloatArray, limit: float) -> float:
    """Chance of a gain as large from noise, with F divided by the excess scatter of the score where poses scatter
    together.

    `explained` is M Z c of the effect, (n_rows,), and `limit` the chance below which it is a finding.
    """
    if not np.isfinite(residuals.pose_freedom):
        return float(tests.p_values[row])
    columns = tests.effects.columns(int(tests.numbers[row]))
    basis = linalg.orth(columns - residuals.span.times(tests.absorbed[row]), rcond=np.sqrt(ABSORBED))
    k, pose = int(tests.ranks[row]), residuals.rows.layout.pose_of_row
    left_over = max(residuals.pose_freedom - k, 1.0)

    def chance(left: FloatArray) -> float:
        scores = [np.bincount(pose, direction * left) for direction in basis.T]
        inflation = float(np.sum(np.square(scores))) / (residuals.factor**2 * basis.shape[1])
        return float(scipy.special.fdtrc(k, left_over, float(tests.ratios[row]) / max(inflation, 1.0)))

    left = residuals.rows.residuals - explained
    result = chance(left)
    if result >= limit:
        return result
    return chance(left + residuals.without_poses.shifts_without_block(left, further_columns=basis)[0])

"""Systematic residuals: patterns that noise does not make.

Question. Would the model explain the data significantly better with one more effect? For an effect with columns Z (what
it would add to the measured rows) the linear model r = J du + Z c is compared with the fit:

    M = I - J A^-1 J^T,   A = J^T J + sigma^2 P        what of Z the fit has not absorbed already
    gain = r^T Z (Z^T M Z)^-1 Z^T r                    by how much |r|^2 would fall
    F = (gain / k) / ((|r|^2 - gain) / (nu - k))       against F(k, nu - k), k columns left after M

The effects are those of `calib.core.judging.effects`. One that the fit absorbs (a constant shift, where the base is
free) cannot be seen and is not tested: `visible` says how large it would have to be. Effects come in families of kinds,
which share the chance of a false finding evenly; in a family, the chance of each finding is multiplied by the number of
its tests. A finding needs a chance below 1 % over all families, and an effect of at least a tenth of the noise: enough
data make any trifle significant. Where poses scatter by more than independent readings would
(`calib.core.numerics.clusters`), F is divided by how much more the score of the effect scatters, summed pose by pose,
and nu is that of this scatter. A fit follows each pose a little, so that its residuals scatter too little: a finding
counts only if it is one with the residuals of each pose by the fit, and the effect, of all other poses. Of waves and of
slips, which are tried by the dozen for each joint or target, the best is kept.

The direction of approach and, without a time, the course of the measurement come from the order of the rows in the data
file, which must be the order of measurement.

Many effects at once. A test needs Z^T Z, (J T)^T Z with the span J T of the fit, and Z^T r only. The effects of a
joint, a target or a frame have the columns of one base times factors of each visit, such as sin(k q_i) and cos(k q_i)
of a wave. So the sums over the rows of a visit are made once for each base and serve all its effects.

When it fails. Effects in other shapes stay in the noise; two effects that look alike at the poses measured are both
named. F supposes normal noise.

Reference: cook1982, chapter 2.4 (added variables), and 3 (residuals without the pose that is judged).
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.judging.effect_kinds import Family, Kind, Pattern, Trait
from calib.core.judging.effects import Effects, EffectSetting, effects
from calib.core.judging.linear_fit import ABSORBED, LinearFit
from calib.core.numerics import linalg
from calib.core.numerics.chances import EXACT, FALSE_ALARM
from calib.core.numerics.tall import in_parts

SMALLEST_EFFECT = 0.1
"""Least root mean square of an effect, over that of the noise, that is worth a finding."""
_NUMBERS_AT_ONCE = 1 << 24  # of what findings explain
_VISITS_AT_ONCE = 512  # their factors stay in the processor's cache
_ALIKE = 9.2  # of the noise squared: chance makes a sine and cosine explain more in 1 % of cases


@dataclass(frozen=True, eq=False)
class _Moments:
    """What tests need to know of m effects with k columns Z each.

    Attributes:
        effects: The effects.
        squares: Z^T Z, (m, k, k).
        absorbed: (J T)^T Z, (m, rank, k).
        score: Z^T r, (m, k).
    """

    effects: Effects
    squares: FloatArray
    absorbed: FloatArray
    score: FloatArray


@dataclass(frozen=True, eq=False)
class _Test:
    """What the test of one effect gave.

    Attributes:
        effects, number: The effect, among those of its kind and name.
        p_value: Chance of such a gain if readings are independent.
        ratio: F of the module docstring.
        freedom: k and nu - k.
        gain: By how much |r|^2 would fall.
        coefficients: c, (n_columns,).
        absorbed: (J T)^T Z, (rank, n_columns).
    """

    effects: Effects
    number: int
    p_value: float
    ratio: float
    freedom: tuple[int, float]
    gain: float
    coefficients: FloatArray
    absorbed: FloatArray

    @property
    def kind(self) -> Kind:
        """Its kind."""
        return self.effects.kind

    @property
    def subject(self) -> tuple[Kind, str]:
        """Its kind, and the joint or target that it is about."""
        return self.effects.kind, self.effects.name


def patterns(residuals: LinearFit, setting: EffectSetting, kinds: Container[Kind] = tuple(Kind)) -> tuple[Pattern, ...]:
    """Test effects.

    Args:
        residuals: The fit.
        setting: What effects are made of.
        kinds: Which of them are tested.
    """
    if residuals.factor * setting.metre < EXACT:
        return ()
    tests = _tests(residuals, [effect for effect in effects(setting) if effect.kind in kinds])
    members = {family: [test for test in tests if test.kind.family is family] for family in Family}
    kept = [(test, len(Family) * len(some)) for some in members.values() for test in _best(some)]
    noise = float(setting.size(np.full((len(residuals.span), 1), residuals.factor))[0])
    result = []
    for part in in_parts(len(kept), max(_NUMBERS_AT_ONCE // len(residuals.span), 1)):
        explained = _explained(residuals, [test for test, _ in kept[part]])
        for (test, times), column, size in zip(kept[part], explained.T, setting.size(explained).tolist(), strict=True):
            p = min(1.0, _chance(residuals, test, column, FALSE_ALARM / times) * times)
            dozen, c = Trait.BY_THE_DOZEN in test.kind.traits, test.coefficients
            amount = float(np.linalg.norm(c)) if dozen else float(c[0]) if len(c) == 1 else float("nan")
            detail = _cycles(test, tests, _ALIKE * residuals.factor**2)
            surely = p < FALSE_ALARM and size > SMALLEST_EFFECT * noise
            result.append(Pattern(*test.subject, p, size, amount, bool(surely), setting.dimension, detail))
    return tuple(sorted(result, key=lambda pattern: (pattern.p_value, -pattern.size)))


def _explained(residuals: LinearFit, tests: Sequence[_Test]) -> FloatArray:
    """Return M Z c of each effect, (n_rows, n_effects), which takes less time for several than `after_fit`."""
    absorbed = residuals.span.times(np.stack([test.absorbed @ test.coefficients for test in tests], axis=1))
    whole = np.stack([test.effects.times(test.number, test.coefficients) for test in tests], axis=1)
    return np.asarray(whole - absorbed)


def _best(tests: list[_Test]) -> list[_Test]:
    """Of the kinds that are tried by the dozen, keep the most significant of each name; of the others, all."""
    kept: dict[tuple[tuple[Kind, str], int], _Test] = {}
    for number, test in enumerate(tests):
        key = test.subject, 0 if Trait.BY_THE_DOZEN in test.kind.traits else number
        if key not in kept or (test.p_value, -test.gain) < (kept[key].p_value, -kept[key].gain):
            kept[key] = test
    return list(kept.values())


def _cycles(best: _Test, tests: Iterable[_Test], margin: float) -> str:
    """Return the detail of an effect; of a wave with all numbers of cycles that explain the residuals as well.

    Args:
        best: The effect.
        tests: All tests.
        margin: How much less of |r|^2 a wave may explain that noise could have made the better one.
    """
    detail = best.effects.details[best.number]
    if best.kind is not Kind.WAVE:
        return detail
    alike = [test for test in tests if test.effects is best.effects and test.gain > best.gain - margin]
    orders, unit = sorted(int(test.effects.details[test.number].split()[0]) for test in alike), detail.partition(" ")[2]
    if len(orders) < 2:
        return detail
    if orders[-1] - orders[0] == len(orders) - 1:
        return f"{orders[0]} to {orders[-1]} {unit}"
    return f"a number of {unit} that these poses do not determine"


def _moments(residuals: LinearFit, some: list[Effects]) -> Iterator[_Moments]:
    """Yield the moments of effects with one base; see the module docstring."""
    base, span = some[0].base, residuals.span
    others = [base, span.jacobian, residuals.rows.residuals[:, None], *([] if span.more is None else [span.more])]
    b, n, width = base.shape[1], len(span.root), sum(other.shape[1] for other in others)
    squares, products = [], []
    for rows, firsts, visits in _visits_together(some[0].visit):
        sums = _sums_of_visits(base[rows], np.hstack([other[rows] for other in others]), firsts)
        factors = [effect.factors(visits) for effect in some]
        squares.append([_squares(sums[:, :, :b], each) for each in factors])
        columns = np.hstack([each.reshape(len(visits), -1) for each in factors])
        products.append((sums.reshape(len(visits), -1).T @ columns).reshape(b, width, -1))
    total, first = sum(products), 0
    for k, effect in enumerate(some):
        square = sum(each[k] for each in squares)
        m, f = len(square), square.shape[1] // b
        own = total[:, :, first : first + m * f].reshape(b, width, m, f).transpose(2, 1, 0, 3).reshape(m, width, b * f)
        own, first = own[:, b:], first + m * f
        absorbed = np.concatenate([residuals.span.root.T @ own[:, :n], own[:, n + 1 :]], axis=1)
        yield _Moments(effect, square, absorbed, own[:, n])


def _squares(sums: FloatArray, factors: FloatArray) -> FloatArray:
    """Return Z^T Z of each effect, (m, b f, b f), from B^T B of visits (n, b, b) and factors (n, m, f)."""
    n, m, f = factors.shape
    b = sums.shape[1]
    pairs = (factors[:, :, :, None] * factors[:, :, None, :]).reshape(n, -1)
    whole = (sums.reshape(n, -1).T @ pairs).reshape(b, b, m, f, f)
    return np.asarray(whole.transpose(2, 0, 3, 1, 4).reshape(m, b * f, b * f))


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


def _sums_of_visits(base: FloatArray, others: FloatArray, firsts: IntArray) -> FloatArray:
    """Return B^T times others, summed over the rows of each visit, (n_visits, b, k).

    Args:
        base: B of rows of visits, one visit after the other, (n, b).
        others: Of these rows, (n, k).
        firsts: First row of each visit, (n_visits,).
    """
    n_visits, length = len(firsts), len(base) // len(firsts)
    if n_visits * length == len(base) and np.array_equal(firsts, length * np.arange(n_visits)):
        each = base.reshape(n_visits, length, -1).transpose(0, 2, 1)  # without the products: a tenth of the time
        return np.asarray(np.matmul(each, others.reshape(n_visits, length, -1)))
    return np.asarray(np.add.reduceat(base[:, :, None] * others[:, None, :], firsts))


def _tests(residuals: LinearFit, some: list[Effects]) -> list[_Test]:
    """Test those effects that can be seen, all with equally many columns at once; those of one base stand together."""
    moments = [
        own
        for _, members in groupby(some, key=lambda effect: id(effect.base))
        for own in _moments(residuals, list(members))
    ]
    tests: dict[tuple[int, int], _Test] = {}
    for width in {own.score.shape[1] for own in moments}:
        places = [
            (k, number)
            for k, own in enumerate(moments)
            if own.score.shape[1] == width
            for number in range(len(own.score))
        ]
        chosen = [own for own in moments if own.score.shape[1] == width]
        for row, test in _tests_at_once(residuals, chosen):
            tests[places[row]] = test
    return [tests[place] for place in sorted(tests)]


def _tests_at_once(residuals: LinearFit, some: list[_Moments]) -> Iterator[tuple[int, _Test]]:
    """Test effects with equally many columns.

    Yields:
        The place of each of them that is tested among all, and its test. The others do nothing that the fit does not
        absorb, or leave no degree of freedom to compare the gain with.
    """
    squares, scores, inside = (
        np.concatenate([getattr(own, name) for own in some]) for name in ("squares", "score", "absorbed")
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
    beside = residuals.freedom - k
    rest = np.maximum(residuals.square - gains, 1e-12 * residuals.square) / np.maximum(beside, 1.0)
    ratios = np.maximum(gains / np.maximum(k, 1) / rest, 0.0)
    chances = scipy.special.fdtrc(np.maximum(k, 1), np.maximum(beside, 1.0), ratios)
    tested = shown & (k > 0) & (beside >= 1)
    rows = zip(
        tested.tolist(), chances.tolist(), ratios.tolist(), k.tolist(), beside.tolist(), gains.tolist(), strict=True
    )
    effect = [(own.effects, number) for own in some for number in range(len(own.score))]
    for row, (counts, chance, ratio, count, freedom, gain) in enumerate(rows):
        if counts:
            yield row, _Test(*effect[row], chance, ratio, (count, freedom), gain, coefficients[row], inside[row])


def _chance(residuals: LinearFit, tested: _Test, explained: FloatArray, limit: float) -> float:
    """Chance of a gain as large from noise; where poses scatter together, F is divided by how much more its score does.

    Args:
        residuals: The fit.
        tested: The effect.
        explained: M Z c, (n_rows,).
        limit: Chance below which it is a finding.
    """
    if not np.isfinite(residuals.pose_freedom):
        return tested.p_value
    columns = tested.effects.columns(tested.number)
    basis = linalg.orth(columns - residuals.span.times(tested.absorbed), rcond=np.sqrt(ABSORBED))
    k, pose = tested.freedom[0], residuals.rows.layout.pose_of_row
    left_over = max(residuals.pose_freedom - k, 1.0)

    def chance(left: FloatArray) -> float:
        scores = [np.bincount(pose, direction * left) for direction in basis.T]
        inflation = float(np.sum(np.square(scores))) / (residuals.factor**2 * basis.shape[1])
        return float(scipy.special.fdtrc(k, left_over, tested.ratio / max(inflation, 1.0)))

    left = residuals.rows.residuals - explained
    result = chance(left)
    if result >= limit:
        return result
    return chance(left + residuals.without_poses.moved(left, beside=basis)[0])

"""Mean and spread of a model's parameters from the results of several robots, and robots that are unlike the others.

Result i has a likelihood of its own n scaled parameters u_i, with precision H_i and information vector h_i,

    log p(data_i | u_i) = -u_i^T H_i u_i / 2 + h_i^T u_i + const,

so that undetermined directions, where H_i is zero, have no effect. The robots differ around a mean,

    u_i = m + d_i,        d_i ~ N(0, diag(t^2)),        m ~ N(0, I),        t_k^2 ~ scaled inverse chi^2 (nu, r^2),

with one typical size r for parameters of a kind (`kinds`), estimated from the data, so that few robots are enough: r is
the geometric mean of the t_k of the kind, and each t_k is drawn towards it with the weight of nu robots. Given t,
everything else is normal:

    A_i = (H_i + diag(1/t^2))^-1            covariance of d_i given m
    V = (I + sum H_i - H_i A_i H_i)^-1,     m = V sum (I - H_i A_i) h_i
    d_i = A_i (h_i - H_i m),                C_i = A_i + A_i H_i V H_i A_i, the covariance of d_i
    t_k^2 = (nu r^2 + sum_i d_ik^2) / f_k,  f_k = nu + sum_i (1 - C_i,kk / t_k^2)

The last line is iterated until it converges. It maximises the restricted marginal likelihood, as for variance
components (`calib.core.numerics.size_search`), and f_k are degrees of freedom. The prediction for one more
robot has Student tails. It is replaced by a normal with the same variance, t_k^2 f_k / (f_k - 2), whose 95 % intervals
are right.

Each result is tested against the others. Without result i, they predict u_i ~ N(m, D + V), with D the diagonal of these
variances. The first test is of all parameters together. It takes the K combinations in which the prediction is wider
than the noise of result i, scales them to variance 1, and tests their mean square. This is a mean of K squares, each of
a scaled Student's t with the typical f_k = f: its mean is 1 and its variance 2 (f - 1) / (f - 4) / K. It is replaced by
the scaled F of K and f' = 4 + (K + 2) (f - 4) / 3 degrees of freedom, with the same mean and variance: many roughly
known spreads are together known well. The second test is of each parameter alone, by a scaled Student's t, as for an
added variable: with B = (D + V)^-1 and S = (B + H_i)^-1, B S (h_i - H_i m) is the score, and the diagonal of B - B S B
its variance. If the data determine only a sum of parameters, each of them is tested by this sum. All tests of a fleet
together give a false alarm with a chance of one in a hundred; each of the two tests has half of that chance. The least
likely result is left out, and everything is estimated again, until no robot is unlike. So one wrong result changes
nothing, and does not hide behind the spread that it causes.

When it fails. It fails if half of the results are wrong. Of two results, neither can be called unlike. Correlated
spreads (all links of a robot are longer) count as independent, so that combinations of them seem narrower than they
are. With three results, and spreads of one kind that differ tenfold, one such fleet of ten has a good robot that is
called unlike.

Reference: patterson1971; gelman2006 for the prior of spreads with few robots.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.core.numerics import linalg
from calib.core.numerics.chances import FALSE_ALARM

_WEIGHT = 4.0  # nu of the module docstring
_SMALLEST = 1e-3  # least typical size r of spreads, in sigmas of single robots
_CONVERGED = 1e-4  # the iteration ends at this relative change of a variance
_ROUNDS = 500
_WIDER = 2.0  # a tested combination has at least this many times the variance of noise
_NOTHING = 1e-2  # a direction with less than this part of the information of a single robot's prior is undetermined
_SHOWN = 0.1  # a parameter is tested if the data give at least this part of its information, the others known


@dataclass(frozen=True, eq=False)
class FleetEvidence(ReadOnlyArrays):
    """Likelihood of scaled parameters from the data of one result: H (n, n) and h (n,) of the module docstring."""

    precision: FloatArray
    information_vector: FloatArray


@dataclass(frozen=True, eq=False)
class Hierarchy(ReadOnlyArrays):
    """Mean and spread, scaled.

    Attributes:
        mean: m, (n,).
        covariance: V of the mean, (n, n).
        variance: Variance of one more robot around the mean, (n,).
        freedom: f, (n,).
        estimates: d_i + m for each result, (n_results, n).
        deviations: Standard deviations of the estimates, (n_results, n).
        n_determined: Number of results that determine each parameter, (n,); one that does so in part counts in part.
    """

    mean: FloatArray
    covariance: FloatArray
    variance: FloatArray
    freedom: FloatArray
    estimates: FloatArray
    deviations: FloatArray
    n_determined: FloatArray

    def compare(self, result: FleetEvidence) -> FleetComparison:
        """Return the comparison of a further result with what these predict."""
        return compare_with_fleet(result, self.mean, np.diag(self.variance) + self.covariance, self.freedom)


@dataclass(frozen=True, eq=False)
class FleetComparison(ReadOnlyArrays):
    """Comparison of a result with the prediction of the others.

    Attributes:
        distances: Deviation of each parameter if it alone is unlike, in standard deviations, (n,); NaN where the
            result does not determine it.
        p_values: Probability of each distance, (n,); NaN without a distance.
        combined_rms: Root mean square over combinations, 1 on average; NaN if there is none.
        p_combined: Probability of `combined_rms`.
    """

    distances: FloatArray
    p_values: FloatArray
    combined_rms: float
    p_combined: float

    def p_value(self) -> float:
        """Return the probability of the less likely test, corrected for the number of tests; NaN without a test."""
        single = self.p_values[np.isfinite(self.p_values)]
        chances = [len(single) * float(np.min(single))] if len(single) else []
        chances += [self.p_combined] if np.isfinite(self.p_combined) else []
        return float(min(1.0, len(chances) * min(chances))) if chances else np.nan


def evidence_of_data(
    covariance: FloatArray, u: FloatArray, prior: FloatArray, mean: FloatArray, freedom: float
) -> FleetEvidence:
    """Return the evidence of the data alone, from an estimate u (n,) with a prior: C^-1 minus the prior's precision.

    C is the covariance, (n, n); the prior has a precision (n, n), 0 for parameters without a prior, and a mean (n,).
    The noise has degrees of freedom, by which the covariance is widened as Student's t.
    """
    inverse = np.linalg.inv(covariance)
    sizes, axes = linalg.eigh((inverse - prior + (inverse - prior).T) / 2)
    kept = axes[:, sizes > _NOTHING]
    shrunk = max(freedom - 2.0, 1.0) / max(freedom, 3.0)
    vector = kept @ (kept.T @ (inverse @ u - prior @ mean))
    return FleetEvidence(shrunk * (kept * sizes[sizes > _NOTHING]) @ kept.T, shrunk * vector)


def learn(results: Sequence[FleetEvidence], kinds: IntArray, start: FloatArray | None = None) -> Hierarchy:
    """Estimate mean and spread of parameters by kind, from 0, (n,), starting from variances t^2 (n,)."""
    variance = np.full(len(kinds), 0.1) if start is None else start.copy()
    for _ in range(_ROUNDS):
        mean, covariance, estimates, spreads = _estimate_given_variance(results, variance)
        seen = np.sum(np.maximum(1.0 - spreads / variance, 0.0), axis=0)
        squares = np.sum(estimates**2, axis=0)
        means = np.array([np.mean(np.log(variance[kinds == kind])) for kind in range(np.max(kinds) + 1)])
        typical = np.maximum(np.exp(means), _SMALLEST**2)[kinds]
        again = (_WEIGHT * typical + squares) / (_WEIGHT + seen)
        change, variance = float(np.max(np.abs(again / variance - 1.0))), again
        if change < _CONVERGED:
            break
    freedom = _WEIGHT + seen
    return Hierarchy(
        mean,
        covariance,
        variance * freedom / (freedom - 2.0),
        freedom,
        estimates + mean,
        np.sqrt(np.array([_estimate_variance(result, variance, covariance) for result in results])),
        np.sum([1.0 - np.diag(_inner(result, variance)) / variance for result in results], axis=0),
    )


def _estimate_given_variance(
    results: Sequence[FleetEvidence], variance: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """m, V, and for each result d_i and the diagonal of C_i, given the variances t^2."""
    n = len(variance)
    inner = [_inner(result, variance) for result in results]
    through = [a @ result.precision for a, result in zip(inner, results, strict=True)]
    both = list(zip(results, through, strict=True))
    precision = np.eye(n) + sum(each.precision - each.precision @ t for each, t in both)
    covariance = np.linalg.inv((precision + precision.T) / 2)
    mean = covariance @ sum(each.information_vector - t.T @ each.information_vector for each, t in both)
    estimates = np.array(
        [a @ (each.information_vector - each.precision @ mean) for a, each in zip(inner, results, strict=True)]
    )
    spreads = np.array([np.diag(a) + np.sum((t @ covariance) * t, axis=1) for a, t in zip(inner, through, strict=True)])
    return mean, covariance, estimates, spreads


def _inner(result: FleetEvidence, variance: FloatArray) -> FloatArray:
    """A of the module docstring, (n, n)."""
    return np.asarray(np.linalg.inv(result.precision + np.diag(1.0 / variance)))


def _estimate_variance(result: FleetEvidence, variance: FloatArray, covariance: FloatArray) -> FloatArray:
    """Variance of m + d_i given the variances t^2, (n,)."""
    inner = _inner(result, variance)
    left = inner / variance  # I - A H
    return np.asarray(np.diag(inner) + np.sum((left @ covariance) * left, axis=1))


def compare_with_fleet(
    result: FleetEvidence, mean: FloatArray, expected: FloatArray, freedom: FloatArray
) -> FleetComparison:
    """Compare a result with what the others predict: mean (n,) with covariance (n, n), and f of the module docstring
    (n,).
    """
    deviation = result.information_vector - result.precision @ mean
    before = np.linalg.inv(expected)
    score = np.linalg.inv(before + result.precision) @ deviation
    determined = np.diag(before - before @ np.linalg.inv(before + result.precision) @ before)
    shown = determined > _SHOWN * np.diag(before)
    distances = np.where(shown, before @ score / np.sqrt(np.where(shown, determined, 1.0)), np.nan)
    p_values = 2.0 * scipy.special.stdtr(freedom, -np.abs(distances) * np.sqrt(freedom / (freedom - 2.0)))
    sizes, axes = linalg.eigh(result.precision)
    kept = sizes > _NOTHING
    root = axes[:, kept] * np.sqrt(sizes[kept])
    ratios, turned = linalg.eigh(root.T @ expected @ root)
    wide = 1.0 + ratios > _WIDER
    if not np.any(wide) or not np.any(shown):
        return FleetComparison(distances, p_values, np.nan, np.nan)
    noise = turned.T @ (axes[:, kept].T @ deviation / np.sqrt(sizes[kept]))
    together = float(np.mean(noise[wide] ** 2 / (1.0 + ratios[wide])))
    count = int(np.sum(wide))
    of_mean = 4.0 + (count + 2.0) * (float(np.median(freedom[shown])) - 4.0) / 3.0
    chance = float(scipy.special.fdtrc(count, of_mean, together * of_mean / (of_mean - 2.0)))
    return FleetComparison(distances, p_values, float(np.sqrt(together)), chance)


def learn_without_odd(
    results: Sequence[FleetEvidence], kinds: IntArray
) -> tuple[Hierarchy, tuple[int, ...], tuple[FleetComparison | None, ...]]:
    """Estimate mean and spread from all results that are not unlike the others.

    Args:
        kinds: Kind of each parameter, (n,).

    Returns:
        Hierarchy of the remaining results; indices of those left out; comparison of each result (None for two results).
    """
    odd: list[int] = []
    indices = range(len(results))
    while True:
        kept = [i for i in indices if i not in odd]
        whole = learn([results[i] for i in kept], kinds)
        start = whole.variance * (whole.freedom - 2.0) / whole.freedom
        compared: list[FleetComparison | None] = []
        for i in indices:
            rest = [results[k] for k in kept if k != i]
            others = learn(rest, kinds, start) if len(rest) > 1 else None
            compared.append(None if others is None else others.compare(results[i]))
        p = np.array([np.nan if likeness is None else likeness.p_value() for likeness in compared])
        p[odd] = np.nan
        worst = int(np.nanargmin(p)) if np.any(np.isfinite(p)) else -1
        if worst < 0 or p[worst] * len(results) >= FALSE_ALARM or len(odd) + 1 > (len(results) - 1) // 2:
            return whole, tuple(sorted(odd)), tuple(compared)
        odd.append(worst)

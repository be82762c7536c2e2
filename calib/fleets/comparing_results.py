"""Results side by side: parameters with their intervals, errors, and the real differences.

Two fits a and b of robots with the same true parameters x, from independent measurements, have the errors

    v_a - x = S_a (J_a^T e_a - L (x - m))        and the same for b,

with covariances S, noise e, and the prior of both: mean m and precision L (zero where there is none). Noise of
different measurements is independent; the pull of the shared prior is not. So their difference has the covariance

    V = S_a + S_b - S_a L S_b - S_b L S_a

With S_a + S_b, parameters that depend on the prior would never differ. Each difference is compared with
its standard deviation by Student's t, with the degrees of freedom of Welch and Satterthwaite; Holm's step-down then
keeps the chance of any false difference below 5 %, over all pairs of results, however the parameters are correlated.
All together are tested by Hotelling's T^2, which detects differences that correlated parameters hide from each other,
again with Holm's step-down over all pairs. Places (of base, targets, instruments) are left out there: a tracker that
was set up elsewhere is not a change of the robot.

When it fails. Fits that used the same readings share their noise: these are not tested. Where errors are systematic
(verdict CHECK) the covariances are too small, and too many differences count as real. A parameter held in one of the
fits moves others. A prior whose size was found, or that differs between the fits, counts as no prior: then fewer
differences are found.

Reference: holm1979, satterthwaite1946.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from pathlib import Path

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError, InputError
from calib.core.base.words import count_noun, distinct_names, listing
from calib.core.fitting.fitted import Fit
from calib.core.numerics import linalg
from calib.core.numerics.chances import HARDLY
from calib.core.results.loaded_result import LoadedResult
from calib.core.results.result_reading import load_result
from calib.core.results.results import to_dict
from calib.fleets.comparison_report import ComparedResult, Difference, Pair, ResultComparison

_OWN = 1e-3  # a difference with less than this part of both variances comes from the prior alone
_ERRORS = {
    "validation": "readings that it did not use",
    "cross_validation": "poses left out in turn",
    "identification": "the readings that it used",
}


@dataclass(frozen=True, eq=False)
class _Result:
    """The compared parts of a result: its name, and the content of its folder."""

    name: str
    loaded: LoadedResult

    @property
    def grade(self) -> str:
        return str(self.loaded.content["verdict"]["grade"])

    @cached_property
    def readings(self) -> dict[str, dict[bytes, float]]:
        return self.loaded.readings()


def compare(*results: Fit | Path | str) -> ResultComparison:
    """Compare results of the same robot; see the module docstring for the tests.

    Args:
        results: Two or more fits, or result folders; they are compared in pairs.

    Raises:
        InputError: Fewer than two, or the same one twice.
        DataError: A folder holds no result, or one of another robot.
    """
    if len(results) < 2:
        raise InputError(f"{count_noun(len(results), 'result')} given; give two or more to compare")
    for given in results:
        if not isinstance(given, (Fit, Path, str)):
            raise InputError(
                f"compare: expected fits or result folders, not {type(given).__name__}; the nominal robot and the"
                " calibrated one of a fit are side by side in fit.to_dataframe()"
            )
    folders = [os.path.realpath(result) for result in results if not isinstance(result, Fit)]
    if len(set(folders)) < len(folders):
        raise InputError("a result folder is given twice; give each once")
    names_of_folders = iter(distinct_names([result for result in results if not isinstance(result, Fit)]))
    loaded = [
        _fitted(given, f"fit {k + 1}")
        if isinstance(given, Fit)
        else _Result(next(names_of_folders), load_result(given, failed_too=True))
        for k, given in enumerate(results)
    ]
    require_one_model([result.loaded for result in loaded])
    pairs = list(combinations(loaded, 2))
    notes: dict[str, list[str]] = {}  # pairs by their note
    for first, other in pairs:
        for note in _notes(first, other):
            notes.setdefault(note, []).append(f"{first.name} and {other.name}")
    tested = [_p_values(first, other) for first, other in pairs]
    names = list(dict.fromkeys(name for result in loaded for name in (p.name for p in result.loaded.robot.parameters)))
    raw = np.array([[p_values.get(name, np.nan) for name in names] for p_values, _ in tested])
    corrected = holm(raw.ravel()).reshape(raw.shape)
    together = holm(np.array([of_all for _, of_all in tested]))
    places = {p.name for result in loaded for p in result.loaded.robot.parameters if p.placement}
    real = [{name for name, p in zip(names, p_values, strict=True) if p < HARDLY} for p_values in corrected]
    rows = [{row["name"]: row for row in result.loaded.content["parameters"]} for result in loaded]
    return ResultComparison(
        _compared(results, loaded),
        tuple(
            Difference(
                name,
                tuple(by_name.get(name) for by_name in rows),
                tuple(map(float, corrected[: len(loaded) - 1, k])),
                name in places,
            )
            for k, name in enumerate(names)
        ),
        tuple(
            Pair(
                (first.name, other.name),
                tuple(name for name in names if name in differing - places),
                tuple(name for name in names if name in differing & places),
                float(all_together),
                tested=bool(np.any(np.isfinite(list(by_name.values())))),
            )
            for (first, other), differing, (by_name, _), all_together in zip(pairs, real, tested, together, strict=True)
        ),
        tuple(f"{listing(of_pairs, '; ')}: {note}" for note, of_pairs in notes.items()),
    )


def holm(p_values: FloatArray) -> FloatArray:
    """Return p-values (n,) corrected for their number by Holm's step-down; NaN, no test, stays NaN."""
    result = np.full(len(p_values), np.nan)
    tested = np.flatnonzero(np.isfinite(p_values))
    order = tested[np.argsort(p_values[tested])]
    factors = np.arange(len(order), 0, -1)
    result[order] = np.minimum(1.0, np.maximum.accumulate(factors * p_values[order]))
    return result


def difference_covariance(first: FloatArray, second: FloatArray, precision: FloatArray) -> FloatArray:
    """Return V of the module docstring, (n, n), from covariances (n, n) and the precision (n,) of the shared prior."""
    shared = first @ (precision[:, None] * second)
    return first + second - shared - shared.T


def _fitted(fit: Fit, name: str) -> _Result:
    loaded = LoadedResult(name, fit.nominal, fit.robot, to_dict(fit), {})
    vars(loaded)["fit"] = fit  # it need not be evaluated again
    return _Result(name, loaded)


def require_one_model(results: Sequence[LoadedResult]) -> None:
    """Raise `DataError` if results are of robots whose URDFs differ in names, links or origins of joints."""
    first, *others = (
        [(joint.name, joint.parent, joint.child, tuple(joint.xyz), tuple(joint.rpy)) for joint in one.robot.urdf.joints]
        for one in results
    )
    for result, geometry in zip(results[1:], others, strict=True):
        if geometry != first:
            raise DataError(f"{result.path}: is the result of another robot than {results[0].path}; their URDFs differ")


def _why_not(first: _Result, other: _Result) -> str:
    """Why the two cannot be tested against each other; empty if they can."""
    failed = [result.name for result in (first, other) if result.grade == "FAIL"]
    if failed:
        return f"the fit of {' and '.join(failed)} failed"
    used = [result.readings.get("identification", {}).keys() for result in (first, other)]
    shared = len(used[0] & used[1])
    return f"both used the same {count_noun(shared, 'reading')}" if shared else ""


def _notes(first: _Result, other: _Result) -> list[str]:
    why = _why_not(first, other)
    if why:
        return [f"no tests, because {why}."]
    notes = ["tested as measurements with independent noise; no reading is in both."]
    only = sorted(set(first.loaded.free_names) ^ set(other.loaded.free_names))
    if only:
        notes.append(f"{count_noun(len(only), 'parameter')} free in only one ({only[0]}); this may make others differ.")
    if "CHECK" in {result.grade for result in (first, other)}:
        notes.append("a verdict is CHECK; where errors are systematic, too many differences count as real.")
    return notes


def _p_values(first: _Result, other: _Result) -> tuple[dict[str, float], float]:
    """p-values by name, not corrected, and the p-value of all together."""
    common = [name for name in first.loaded.free_names if name in other.loaded.free_names]
    if _why_not(first, other) or not common:
        return {}, np.nan
    (value_a, cov_a, sigma_a), (value_b, cov_b, sigma_b) = (
        _common_parameters(result, common) for result in (first, other)
    )
    shared = np.isfinite(sigma_a) & (sigma_a == sigma_b)
    both = difference_covariance(cov_a, cov_b, np.where(shared, 1.0 / np.where(shared, sigma_a, 1.0) ** 2, 0.0))
    variance, total = np.diag(both), np.diag(cov_a) + np.diag(cov_b)
    testable = variance > _OWN * total
    freedom_a, freedom_b = (float(result.loaded.content["degrees_of_freedom"]) for result in (first, other))
    freedom = total**2 / (np.diag(cov_a) ** 2 / freedom_a + np.diag(cov_b) ** 2 / freedom_b)
    change = value_b - value_a
    t = np.abs(change) / np.sqrt(np.where(testable, variance, 1.0))
    p = np.where(testable, 2.0 * scipy.special.stdtr(freedom, -t), np.nan)
    of_robot = np.array([not first.loaded.robot.parameters[name].placement for name in common])
    scale = np.sqrt(total[of_robot])
    sizes, axes = linalg.eigh(both[np.ix_(of_robot, of_robot)] / np.outer(scale, scale))
    kept = sizes > _OWN
    squares = (axes[:, kept].T @ (change[of_robot] / scale)) ** 2 / sizes[kept]
    n, least = int(np.sum(kept)), min(freedom_a, freedom_b)
    together = float(scipy.special.fdtrc(n, least, np.sum(squares) / n)) if n else np.nan
    return dict(zip(common, map(float, p), strict=True)), together


def _common_parameters(result: _Result, common: Sequence[str]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Values, covariance, and known sigmas of priors (NaN: none) of these free parameters [SI]."""
    robot, free = result.loaded.robot, result.loaded.free_names
    at, place = robot.parameters.places(common), [free.index(name) for name in common]
    shown = [robot.parameters[k] for k in at]
    sigma = [p.sigma_si if p.prior and not p.family and p.mean_si is None else np.nan for p in shown]
    return robot.values[at], result.loaded.uncertainty.covariance[np.ix_(place, place)], np.array(sigma)


def _compared(given: Sequence[Fit | Path | str], results: Sequence[_Result]) -> tuple[ComparedResult, ...]:
    """Each result with its root mean square error, if possible on readings that none used and all predicted."""
    unit = results[0].loaded.content["instruments"][0]["parts"][0]["unit"]
    unseen = [result.readings.get("validation", {}) for result in results]
    shared = set(unseen[0]).intersection(*unseen[1:])
    same = [key for key in unseen[0] if key in shared and np.isfinite(unseen[0][key])]
    compared = []
    for one, result, squares in zip(given, results, unseen, strict=True):
        content, sizes = result.loaded.content, np.sqrt([squares[key] for key in same])
        if same:
            rms, on = float(np.sqrt(np.mean(sizes**2))), f"the same {count_noun(len(same), 'reading')} not used"
        else:
            rms, on = _own_error(result, unit)
        folder = None if isinstance(one, Fit) else str(one)
        compared.append(ComparedResult(result.name, folder, result.grade, content["n_poses"], rms, unit, on, sizes))
    return tuple(compared)


def _own_error(result: _Result, unit: str) -> tuple[float, str]:
    """Root mean square error of a result on its own readings, and which these are."""
    content = result.loaded.content
    best = next(name for name in _ERRORS if name in content["errors"])
    value, claim = content["errors"][best]["after"]["rms"], content["verdict"].get("claim")
    if best == "identification" and claim and claim["unit"] == unit:  # errors at used readings are always smaller
        best, value = "cross_validation", claim["rms"]
    return np.nan if value is None else float(value), _ERRORS[best]

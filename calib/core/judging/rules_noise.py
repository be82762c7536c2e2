"""Rules of the verdict about noise: found against stated, and against the usual noise of such instruments."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.core.base.memoize import memoize
from calib.core.base.units import ERROR_UNIT, quantity_text
from calib.core.fitting.fitted import Fit
from calib.core.fitting.likely_mistakes import LARGE_NOISE
from calib.core.fitting.mistaken_readings import errors_of_parts, jumbled_errors, mistaken_readings
from calib.core.fitting.solved_fit import NoiseEstimate
from calib.core.instruments.kind import Part
from calib.core.judging import findings
from calib.core.judging.better_or_worse import comparisons
from calib.core.judging.reasons import Answer, Code, Reason
from calib.core.numerics.chances import UNLIKELY
from calib.core.numerics.statistics import chi_square

NOISE_RATIO = 3.0
"""If the found noise is more than this many times the stated one, the statement or the model is wrong."""
MOST_LEFT_OUT = 20.0
"""Beyond this ratio of found to stated noise, better poses prove nothing: the joint origins of real robots leave up to
ten times the noise of a tracker; a target that is described on a neighbouring link leaves seventy times."""
GROSS = 2.0
"""If every instrument has more than this many times its largest usual noise, the model makes most of the errors."""
NO_BETTER = 0.15
"""Where no positions are measured, nothing fits if the noise is more than this part of the errors with joint values of
other rows."""
DOUBTFUL = 0.05
"""Above this part of an impossible noise, the program tries other meanings of an instrument's numbers."""
GROSS_RATIO = 50.0
"""Mistakes in the data are looked for if the found noise is more than this many times the stated one."""
LEFT_OUT = 0.01
"""A model of a healthy robot may leave this part of the spread of the measured positions (real ones: 0.1 %)."""
NOT_STATED = 2.0
"""Factor on that limit where the noise of the instrument is not stated and adds to it: a camera that observes a small
space has 1 % of it."""


def noise(fit: Fit) -> Iterator[Reason]:
    """Compare the found noise with the positions, with the stated noise, and with usual noise of such instruments."""
    sigma, spread = fit.sigma, _spread(fit)
    if sigma > LARGE_NOISE * spread:
        yield Code.NOISE_AS_LARGE_AS_ROBOT.says(
            f"no fit: residuals of {quantity_text(sigma, 'mm', '.4g')} per axis, where the positions spread over"
            f" {quantity_text(spread, 'mm', '.4g')}. Check units, axes, joint order and signs, and whether joint values"
            " and positions of each row belong together",
            answer=_first_answer(fit),
        )
    elif fit.computed:
        yield Code.NO_NOISE.says(
            f"noise found: {noise_in_words(fit.first_noise, sigma, 1)}, less than any sensor has; these data were"
            " computed, not measured, and the intervals say nothing about a real robot. Give measured readings, or"
            " simulated ones that have noise"
        )
    else:
        jumbled = {} if np.isfinite(spread) else _jumbled_errors(fit)
        for estimate in fit.noise:
            size = jumbled.get((estimate.group.name, estimate.group.part), np.inf)
            if _is_doubted(estimate) and estimate.sigma > NO_BETTER * size:
                yield Code.NOISE_AS_LARGE_AS_ROBOT.says(
                    f"no fit: residuals{_group_in_words(fit, estimate)} of"
                    f" {noise_in_words(estimate, estimate.sigma)} per axis; with joint values of other rows they are"
                    f" {noise_in_words(estimate, size)}. Check units, axes, joint order and signs, names of what was"
                    " read, and whether joint values and readings of each row belong together; or move the joints more",
                    answer=_first_answer(fit),
                )
            elif _impossible(fit, estimate):
                yield _no_fit_reason(fit, estimate)
            elif estimate.freedom > 0:
                yield from (
                    _check_usual_noise(fit, estimate) if estimate.stated is None else _check_statement(fit, estimate)
                )


def _jumbled_errors(fit: Fit) -> dict[tuple[str, Part], float]:
    """Errors with each joint at its value in some row [SI], by group; none of readings that this does not change."""
    data, sizes = fit.identification.data, dict[tuple[str, Part], float]()
    now = errors_of_parts(fit.robot, data)
    for (name, part), size in jumbled_errors(fit.robot, data).items():
        if not np.isclose(size, now.get((name, part), 0.0)):
            group = fit.robot.instrument(name).group, part
            sizes[group] = max(sizes.get(group, 0.0), size)
    return sizes


def misread(fit: Fit) -> Iterator[Reason]:
    """Look for noise that no such instrument has on any robot, and for another meaning of its numbers."""
    for estimate in fit.noise:
        if not estimate.sigma > DOUBTFUL * estimate.group.part.largest:
            continue
        data, beyond = fit.identification.data, ""
        readers = [name for name in data.readings if fit.nominal.instrument(name).group == estimate.group.name]
        meaning = next(filter(None, (mistaken_readings(fit.nominal, data, name) for name in readers)), "")
        if estimate.sigma > estimate.group.part.largest:
            beyond = f", more than any such instrument has ({noise_in_words(estimate, estimate.group.part.largest)})"
        if meaning or beyond:
            yield Code.MISREAD.says(
                f"noise found of {estimate.group.name}, {estimate.group.part.name}, is"
                f" {noise_in_words(estimate, estimate.sigma)} per axis{beyond}: the numbers mean something else;"
                f" {meaning or 'look at their order, form, unit and frame'}"
            )


def noise_in_words(estimate: NoiseEstimate, size: float, digits: int = 3) -> str:
    """Return a noise [SI] in the unit of its group."""
    return quantity_text(size, ERROR_UNIT[estimate.group.part.dimension], f".{digits}g")


def _group_in_words(fit: Fit, estimate: NoiseEstimate) -> str:
    return f" of {estimate.group.name}, {estimate.group.part.name}," if len(fit.noise) > 1 else ""


def _check_usual_noise(fit: Fit, estimate: NoiseEstimate) -> Iterator[Reason]:
    usual, used = estimate.group.part.usual, fit.identification.data.readings.keys()
    if estimate.sigma > usual:
        none_fits = all(other.stated is None and other.sigma > GROSS * other.group.part.usual for other in fit.noise)
        another = fit.validation is not None and bool(fit.validation.data.readings.keys() - used)
        proven = another and any(comparison.better for comparison in comparisons(fit))
        yield Code.NOISE.says(
            f"noise found{_group_in_words(fit, estimate)} is {noise_in_words(estimate, estimate.sigma)} per"
            f" axis, more than such an instrument has ({noise_in_words(estimate, usual)} at most): the model does not"
            " explain the measurements, and the parameters may be wrong. Look for what is missing or wrong in the"
            " description of the instrument, and check the result with another instrument",
            grade="FAIL" if none_fits and not proven else "CHECK",
            counted=False,
        )


def unproven(fit: Fit) -> bool:
    """Whether noise is so far above its statement that only unused poses show whether the fit can be used."""
    beyond = [] if fit.computed else [estimate for estimate in fit.noise if _is_above_statement(estimate)]
    provable = bool(beyond) and all(_may_be_left_out(fit, estimate) for estimate in beyond)
    return provable and not any(comparison.better or comparison.worse for comparison in comparisons(fit))


def _is_above_statement(estimate: NoiseEstimate) -> bool:
    if estimate.stated is None or estimate.freedom <= 0:
        return False
    ratio = estimate.sigma / estimate.stated
    return ratio > NOISE_RATIO and chi_square(ratio, estimate.freedom).p_larger < UNLIKELY


def impossible(fit: Fit) -> bool:
    """Whether some noise is unstated or above its statement, and more than the model of a healthy robot leaves."""
    return not fit.computed and any(_impossible(fit, estimate) for estimate in fit.noise)


def _is_doubted(estimate: NoiseEstimate) -> bool:
    return estimate.stated is None or _is_above_statement(estimate)


def _impossible(fit: Fit, estimate: NoiseEstimate) -> bool:
    return estimate.freedom > 0 and _is_doubted(estimate) and not _may_be_left_out(fit, estimate)


def _no_fit_reason(fit: Fit, estimate: NoiseEstimate) -> Reason:
    found = f"noise found{_group_in_words(fit, estimate)} is {noise_in_words(estimate, estimate.sigma)} per axis"
    return Code.NOISE.says(
        f"{found if estimate.stated is None else _noise_over_statement(fit, estimate, '.1f')}: the model does not"
        " explain the measurements; a healthy robot does not leave more than"
        f" {100 * _most(estimate):g} % of the measured space ({quantity_text(_spread(fit), 'mm', '.4g')}): check units,"
        " joint order and signs, and outliers; if all of it is noise, state that noise (--sigma-mm)",
        grade="FAIL",
        answer=_first_answer(fit),
    )


def _noise_over_statement(fit: Fit, estimate: NoiseEstimate, form: str, only: str = "") -> str:
    stated = estimate.stated or np.nan
    return (
        f"noise found{_group_in_words(fit, estimate)} is {only}{estimate.sigma / stated:{form}} times what was stated"
        f" ({noise_in_words(estimate, estimate.sigma)} per axis where {noise_in_words(estimate, stated)} was stated)"
    )


def _first_answer(fit: Fit) -> Answer:
    """First answer to noise that no healthy robot leaves, since a few wrong readings can cause all of it."""
    return Answer.LEAVE_OUT if findings.outliers(fit) else Answer.CORRECT


def is_noise_too_large(fit: Fit) -> bool:
    """Whether noise, stated or not, is so large that a mistake in the data may be the cause."""
    ratios = [estimate.sigma / estimate.stated for estimate in fit.noise if estimate.stated]
    return not fit.computed and (fit.sigma > LEFT_OUT * _spread(fit) or max(ratios, default=0.0) > GROSS_RATIO)


def _may_be_left_out(fit: Fit, estimate: NoiseEstimate) -> bool:
    """Whether a noise may come from errors of a healthy robot that the model leaves out, and from unstated noise."""
    return estimate.group.part.dimension != "length" or estimate.sigma < _most(estimate) * _spread(fit)


def _most(estimate: NoiseEstimate) -> float:
    return LEFT_OUT if estimate.stated is not None else NOT_STATED * LEFT_OUT


def _check_statement(fit: Fit, estimate: NoiseEstimate) -> Iterator[Reason]:
    chi = chi_square(estimate.sigma / (estimate.stated or 1.0), estimate.freedom)
    if _is_above_statement(estimate):
        yield _noise_above_statement(fit, estimate)
    elif chi.p_larger < UNLIKELY:
        yield Code.NOISE.says(
            f"{_noise_over_statement(fit, estimate, '.2f')}, more than chance explains: state the noise of robot and"
            " sensor together, or look for what the model leaves out"
        )
    elif chi.p_smaller < UNLIKELY:
        yield Code.NOISE.says(
            f"{_noise_over_statement(fit, estimate, '.2g', 'only ')}, less than chance explains: state a smaller noise,"
            " or look for readings that were used more than once",
            answer=Answer.STATE_NOISE,
        )


def _noise_above_statement(fit: Fit, estimate: NoiseEstimate) -> Reason:
    text = f"{_noise_over_statement(fit, estimate, '.1f')}: the model does not explain the measurements;"
    compared = comparisons(fit)
    better = any(comparison.better for comparison in compared)
    bounded = estimate.group.part.dimension == "length" and np.isfinite(_spread(fit))
    if not better and not (bounded and compared and not any(comparison.worse for comparison in compared)):
        text += (
            " look at outliers and units, state the noise of robot and sensor together (--sigma-mm), or prove the"
            " result on other poses (--validate, --folds)"
        )
        return Code.NOISE.says(text, grade="FAIL")
    outcome = "get better by more than chance explains" if better else "get neither better nor worse"
    text += (
        f" poses that were not used {outcome}. The remaining error is what the model leaves out, or outliers. The"
        " uncertainty of positions includes it. State the noise of robot and sensor together (--sigma-mm)"
    )
    if estimate.sigma <= MOST_LEFT_OUT * (estimate.stated or np.inf):
        return Code.NOISE.says(text)
    text += (
        f". On real robots, joint origins leave errors below {MOST_LEFT_OUT:g} times an instrument's noise:"
        " look at the targets' links, and at units, gear ratios and order of the joint columns"
    )
    return Code.NOISE.says(text, counted=False)


@memoize
def measured_space(fit: Fit) -> float:
    """Root mean square distance of measured positions from their centre [m], of the widest instrument; inf if none."""
    sizes = []
    for name, readings in fit.identification.data.readings.items():
        points = fit.robot.instrument(name).points(readings.values)
        if points is not None and len(points):
            sizes.append(float(np.sqrt(np.sum(np.nanvar(points, axis=0)))))
    return max(sizes, default=np.inf)


def _spread(fit: Fit) -> float:
    """Root mean square of the same distance along each axis [m]."""
    return measured_space(fit) / np.sqrt(3.0)

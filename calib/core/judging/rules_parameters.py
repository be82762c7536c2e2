"""Rules of the verdict about parameters: distance from nominal, uncertainty, and scales."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.parameter import Parameter
from calib.core.base.units import quantity_text
from calib.core.base.words import joints_named, listing
from calib.core.fitting.fitted import Fit
from calib.core.fitting.pose_checks import unmoved_joints
from calib.core.judging import findings
from calib.core.judging.reasons import Code, Reason
from calib.core.judging.row_derivatives import constants, errors_in_links, gains, own_scales, scales
from calib.core.judging.rules_noise import impossible
from calib.core.numerics import linalg
from calib.core.numerics.chances import EXACT, UNLIKELY
from calib.core.numerics.identifiability import NO_EFFECT, extend_reduced, unit_columns
from calib.core.numerics.observability import posterior_information
from calib.core.numerics.prior import Prior
from calib.core.numerics.tall import slices
from calib.core.robots.joint_errors import columns_of_terms, driven_by
from calib.core.robots.terms.one_coefficient import Gain
from calib.core.robots.terms.term import Context
from calib.core.robots.terms.terms import TERMS

PLAUSIBLE = 4.0
"""Number of its sigmas by which a parameter may differ from nominal."""
DOUBTFUL = 10.0
"""Expected errors (sigmas) beyond which doubt remains, also where unused poses fit: a target on an earlier link than
described fits once axes of joints that do not move it are bent through it, by 16 sigma (UR5). Real robots stay below
6."""
IMPOSSIBLE = 20.0
"""Expected errors (sigmas) that a parameter cannot be away from nominal: `PLAUSIBLE` of them, if the sigma was guessed
five times too small. Calibrated robots stay near 2; a joint counted the wrong way gives hundreds, and its prior then
pulls all other parameters out of place."""
SMALLEST_SHARE = 0.05
"""Share of a parameter's variance that the data must remove before its deviation counts."""
SCALED = 2e-3
"""Relative error of all lengths that is too large for any robot or instrument: heat makes a tenth of it."""
SCALED_IN_PART = 4e-3
"""The same of lengths along one axis or of one instrument: photogrammetry of a real robot (Motoman) has 0.0029."""
SCALED_SIGMAS = 6.0
"""A scale further from 1 than this many of its standard deviations is not explained by errors of the parameters. Few
degrees of freedom take more: as many as chance does not explain, by Student's t (`_least_sigmas`)."""
MOST = 0.5
"""A scale is the cause if it explains this part of the squares (of residuals and deviations) that noise leaves over:
other errors look a bit like a scale."""
_SCALED_LENGTHS = ("all measured lengths", *(f"measured lengths along {axis}" for axis in "xyz"))
_NOTHING = 1e-6  # a robot scaled by less than this has shrunk to a point
FLAT = 0.4
"""Mean square of directions of errors along one axis of a link over that along the others, below which these have a
cause of their own."""
_IN_PLANE = 0.2  # largest part of an error along the normal of a plane in which it lies
JOINT_OFF = 0.01
"""Usual error of a joint that is no gear's [rad]: half a degree."""
_ALIKE = 0.9  # mean of unit vectors that hardly turn
MANIFOLD = 0.3
"""Messages state a larger scale error as a ratio of lengths, a smaller one in percent."""
UNUSUAL = 10.0
"""If a chosen joint term is more than this many times its usual size, something else may be the cause."""
JOINT_SCALED = 0.01
"""Relative error of motion that no joint has: gears, belts and screws are off by a thousandth."""
_SUREST = 0.2  # least certainty of a scale, as part of the largest: a curved error looks like smaller scales
LOOSE_ANGLE = 0.1
"""The effect of an angle with a larger standard deviation is not linear [rad]."""


def far_from_nominal(fit: Fit) -> Iterator[Reason]:
    """List parameters far from nominal.

    Priors share an error between parameters that the data cannot distinguish, so each moves by less than the error. If
    the data decide a share p of a parameter, its deviation is expected to be sqrt(p) sigma, and is compared with that.
    Without a prior, noise alone moves a parameter too: two standard deviations of it are allowed. The place of a target
    is never impossible: its place in the description may be a guess.
    """
    away = sorted(_deviations(fit), key=lambda entry: -entry[1])
    impossible = [(p, size) for p, size in away if size > IMPOSSIBLE and not p.placement]
    far = [(p, size) for p, size in away if size > PLAUSIBLE]
    beyond = "times as far from nominal as their stated sigma allows"
    if impossible:
        words = listing([f"{parameter.name} ({size:.0f} sigma)" for parameter, size in impossible])
        yield Code.FAR_FROM_NOMINAL.says(
            f"parameters are more than {IMPOSSIBLE:g} {beyond}: {words}."
            " No error of the stated size explains this: check signs, zeros and order of the joint columns, and units."
            " If such an error is possible, state a larger sigma in the description"
        )
    elif far:
        words = listing([f"{parameter.name} ({size:.1f} sigma)" for parameter, size in far])
        yield Code.AT_BOUNDS.says(
            f"parameters are more than {PLAUSIBLE:g} {beyond}: {words}; check zero positions, units and the targets'"
            " links. If such an error is possible, state a larger sigma in the description",
            counted=far[0][1] <= DOUBTFUL,
        )


def lengths_scaled(fit: Fit) -> Iterator[Reason]:
    """Report one scale of lengths that explains why parameters are far from nominal: a unit, or an artefact's size.

    In the linear model around the solution, with deviations u over the sigmas of all parameters but placements, a scale
    s of all readings, of those along one axis or of one instrument is tried together with the parameters:
    |r + J du + z s|^2 / (1 + s)^2 + |u + du|^2. With all readings, noise is scaled as well if lengths are read:
    otherwise, if all lengths of a robot are free, lengths of zero would explain it best. Residuals are divided by the
    found noise: without a scale, their squares add up to about the number of rows less that of places. Joints that turn
    too far draw larger arcs, which look like longer links: if gains of all joints explain as much, the scale is not the
    cause; that of one instrument is not if constants in the readings explain as much. Doubt remains where these explain
    nearly as much, and where a scale is less sure, but above a hundredth, or a parameter is far from nominal.
    """
    if fit.computed:
        return
    setting = findings.setting(fit)
    own = [(name, fit.whitening.groups[group].part.dimension == "angle") for name, group in own_scales(setting)]
    names = [*_SCALED_LENGTHS, *(f"{'angles' if is_angle else 'readings'} of {name}" for name, is_angle in own)]
    left, right, n_measured = _remaining_residuals(fit)
    scaled_by, n_gains = left[:, : len(names)], len(fit.nominal.joint_names)
    if not np.any(scaled_by):
        return
    scales_noise = any(group.part.dimension == "length" for group in fit.whitening.groups)
    tried = [
        _cost_with(scaled_by[:, [k]], right, n_measured, is_scale=scales_noise and k == 0) for k in range(len(names))
    ]
    best = tried.index(min(tried))
    scaled, part = tried[best]
    if abs(part) <= (SCALED if best == 0 else SCALED_IN_PART):
        return
    alone, _ = _cost_with(left[:, :0], right, n_measured)
    others = np.split(left[:, len(names) :], [n_gains], axis=1)[: 2 if best >= len(_SCALED_LENGTHS) else 1]
    likelier = min(_cost_with(columns, right, n_measured)[0] for columns in others)
    by_noise = findings.linear(fit).rows.layout.n_read - int(np.sum(fit.unknowns.placement))
    shown = alone - scaled > _least_sigmas(fit, 1) ** 2
    far = abs(part) > JOINT_SCALED or any(away > PLAUSIBLE for _, away in _deviations(fit))
    doubtful = alone - scaled > PLAUSIBLE**2 and far
    if (shown or doubtful) and alone - scaled > MOST * (alone - by_noise) and scaled < likelier:
        is_angle = best >= len(_SCALED_LENGTHS) and own[best - len(_SCALED_LENGTHS)][1]
        less, more, same = ("smaller", "larger", "large") if is_angle else ("shorter", "longer", "long")
        text = f"{100 * abs(part):.2g} % {less if part > 0 else more} than"
        if abs(part) > MANIFOLD:
            text = f"{1.0 / max(1.0 + part, _NOTHING):.3g} times as {same} as"
        yield Code.LENGTHS_SCALED.says(
            f"{names[best]} are {text} in the description: no robot is that far off. Look at the unit and form of the"
            " measurements, the scale of the instrument and the size of the artefact",
            grade="FAIL" if shown and likelier - scaled > PLAUSIBLE**2 else "CHECK",
        )


def _least_sigmas(fit: Fit, n_scales: int) -> float:
    """Standard deviations, by the noise found beside some scales, from which one of these is sure."""
    freedom = fit.statistics.freedom - n_scales
    return max(SCALED_SIGMAS, float(-scipy.special.stdtrit(freedom, UNLIKELY / 2))) if freedom > 0 else np.inf


def _remaining_residuals(fit: Fit) -> tuple[FloatArray, FloatArray, int]:
    """Return what parameters leave of further columns, and of the residuals, divided by the found noise.

    Of a column that parameters explain, rounding errors remain; it becomes zero.

    Returns:
        Remainders of scales, gains and constants, (n, k), and of the residuals, (n,): a few rows with the same J^T J as
        all measured rows, then a row for each deviation of a parameter; and the number of these measured rows.
    """
    setting, linear, inside, n = findings.setting(fit), findings.linear(fit), ~fit.unknowns.placement, len(fit.unknowns)
    rows, lengths = linear.rows, scales(setting)
    predicted = lengths[:, :1] - np.where(lengths[:, :1] != 0.0, rows.residuals[:, None], 0.0)
    others = [gains(setting), *(columns for _, _, columns in constants(setting)), rows.residuals[:, None]]
    tried = np.hstack([predicted, lengths, *own_scales(setting).values(), *others])
    known = posterior_information(rows.factor[:n, :-1] / linear.factor, Prior(inside))
    left = np.zeros((n, tried.shape[1]))
    left[inside, -1] = rows.deviations[inside]
    step = -known.solve(rows.jacobian.T @ tried / linear.factor**2 + left)
    measured: FloatArray = np.zeros((0, tried.shape[1]))
    for part in slices(len(tried)):
        measured = extend_reduced(measured, (tried[part] + rows.jacobian[part] @ step) / linear.factor)
    remainders = np.vstack([measured, (left + step)[inside]])
    whole = np.linalg.norm(tried, axis=0)[:-1] / linear.factor
    remainders[:, :-1] *= np.linalg.norm(remainders[:, :-1], axis=0) > NO_EFFECT * whole
    remainders[:, 1] *= np.any(remainders[:, 0])  # where parameters explain what is predicted, what is read is noise
    return remainders[:, 1:-1], remainders[:, -1], len(measured)


def _cost_with(
    columns: FloatArray, right: FloatArray, n_measured: int, *, is_scale: bool = False
) -> tuple[float, float]:
    """Return the least cost of the residuals (n,) with some columns (n, k) fitted, and the size of the first.

    Of the rows, `n_measured` are measured; `is_scale` says whether the column scales all lengths, and noise with them.
    """
    unit, size = unit_columns(columns)
    alone = unit.shape[1] == 1  # of one unit column, the product is the solution
    solution = -(unit.T @ right) if alone else linalg.lstsq(unit, -right, rcond=None)
    squares = (unit @ solution + right) ** 2
    first = float(solution[0] / size[0]) if len(size) else 0.0
    noise = max(abs(1.0 + first), _NOTHING) ** 2 if is_scale else 1.0
    return float(np.sum(squares[:n_measured]) / noise + np.sum(squares[n_measured:])), first


def joints_scaled(fit: Fit) -> Iterator[Reason]:
    """Look for joints that move further or less than their values say: joint terms or the residuals show the factor.

    Joint origins hide most of it: a robot may fit to a tenth of a millimetre although a motor turns three percent too
    far. The residuals still show the factors of all joints, each with all others fitted.
    """
    if fit.computed:
        return
    names, still = fit.nominal.joint_names, unmoved_joints(fit.nominal, fit.identification.data.joints)
    moved = np.array([float(name not in still) for name in names])
    scales = np.zeros(len(names))
    left = findings.linear(fit).sizes(moved * gains(findings.setting(fit)))
    for parts, deviations in (left, _gain_errors(fit)):
        sure = np.abs(parts) / np.maximum(deviations, EXACT)
        scales += np.where(sure > max(_least_sigmas(fit, int(np.sum(moved))), _SUREST * np.max(sure)), parts, 0.0)
    scaled = np.flatnonzero(np.abs(scales) > np.maximum(JOINT_SCALED, PLAUSIBLE * _expected_gains(fit)))
    if len(scaled):
        factors = [f"{joints_named(names[j])} {1.0 + scales[j]:.4g} times as far" for j in scaled]
        yield Code.JOINT_SCALED.says(
            f"joints do not move as their values say: {listing(factors)}. No gear is off by more than"
            f" {100 * JOINT_SCALED:g} %: look at the unit and the range of these columns, and at the gear ratios of the"
            " controller and of the description"
        )


def joint_moves_otherwise(fit: Fit) -> Iterator[Reason]:
    """Look for a last joint that moves otherwise than its values say: of other rows, in another unit, without sign.

    It moves a target in a plane of the target's link, across its own axis. If what the fit leaves lies in such a plane,
    which turns with the link, this joint makes it, or another one whose errors lie there. An error that none of them
    can have is a mistake. A target far from the axis shows it by its noise, too; one near the axis, by this alone.
    """
    if fit.computed or fit.robot.mechanism.loops or impossible(fit):
        return
    setting = findings.setting(fit)
    for rows, axes, errors in errors_in_links(setting, findings.linear(fit).rows.residuals):
        sizes = np.linalg.norm(errors, axis=1)
        directions = errors / np.maximum(sizes, EXACT)[:, None]  # a few wrong readings do not decide
        squares, vectors = linalg.eigh(directions.T @ directions)
        normals = axes @ vectors[:, 0]
        columns = setting.joint_columns[rows]
        levers = np.linalg.norm(columns, axis=(0, 1))
        along = np.linalg.norm(np.einsum("ni,nij->nj", normals, columns), axis=0)
        causes = levers[(levers > 0) & (along <= _IN_PLANE * levers)]
        if not len(causes) or np.linalg.norm(np.mean(normals, axis=0)) > _ALIKE:
            continue
        last = fit.nominal.joint_names[np.flatnonzero(levers)[-1]]
        freedom = fit.statistics.freedom * len(errors) / fit.rows.layout.n_read
        ratio = 2.0 * float(squares[0]) / max(float(squares[1] + squares[2]), EXACT)
        off = float(np.median(sizes) * np.sqrt(len(sizes)) / np.max(causes))
        flat = ratio < FLAT and scipy.special.fdtr(freedom, 2.0 * freedom, ratio) < UNLIKELY**2
        if flat and off > JOINT_OFF and fit.nominal.mechanism.dimensions[last] == "angle":
            yield Code.JOINT_SCALED.says(
                f"{joints_named(last)} does not move as its values say: residuals lie in a plane that turns with the"
                " link that it moves. Check the rows, the unit, the sign and the counted turns of its column"
            )


def _expected_gains(fit: Fit) -> FloatArray:
    """Standard deviations of gains of the actuated joints as described, (n_actuated,); 0 where their size was found."""
    robot, expected = fit.nominal, np.zeros(len(fit.nominal.joint_names))
    found = () if fit.terms is None else [trial.term for trial in fit.terms.trials if trial.added]
    for term in (term for term in robot.terms if isinstance(term, Gain) and "gain" not in found):
        expected[list(driven_by(term, robot.mechanism))] = term.parameters[0].sigma_si
    return expected


def _gain_errors(fit: Fit) -> tuple[FloatArray, FloatArray]:
    """How much further each joint moves by its own terms, relative, and the standard deviation of this, (n_actuated,).

    It is the slope of the straight line through the errors of the joint at the used poses.
    """
    robot, q = fit.robot, fit.identification.data.joints
    slopes = np.zeros((len(robot.joint_names), len(robot.parameters)))
    columns = columns_of_terms(robot.terms, robot.mechanism, q, Context.neutral(*q.shape))
    for (term, own), phi in zip(robot.terms_with_places(), columns, strict=True):
        if term.adds and not term.depends_on:
            for moved, j in enumerate(driven_by(term, robot.mechanism)):
                from_middle = q[:, j] - np.mean(q[:, j])
                slopes[j, own] += from_middle @ phi[:, moved] / max(float(from_middle @ from_middle), EXACT)
    of_free = slopes[:, fit.unknowns.index]
    variances = np.einsum("ij,jk,ik->i", of_free, fit.covariance.values, of_free)
    return slopes @ robot.values, np.sqrt(np.maximum(variances, 0.0))


def large_terms(fit: Fit) -> Iterator[Reason]:
    """List chosen joint terms that are much larger than usual: each was fitted with the sigma it needs.

    `joints_scaled` treats gains.
    """
    tried = () if fit.terms is None else fit.terms.trials
    large = [term for term in tried if term.added and term.size > UNUSUAL and not issubclass(TERMS[term.term], Gain)]
    words = listing([f"{term.term} ({term.size:.0f} times)" for term in large])
    if words:
        yield Code.LARGE_TERMS.says(
            f"joint terms that were added are more than {UNUSUAL:g} times as large as is usual: {words}; look for a"
            " ratio, unit, mass or load that is wrong in the description or the data"
        )


def unlike_fleet(fit: Fit) -> Iterator[Reason]:
    """Name parameters unlike those of the fleet, for which the fleet's prior was not used."""
    fleet = fit.nominal.description.fleet
    if fleet is not None and fleet.unlike:
        whole = len(fleet.unlike) == len(fleet.parameters)
        extent = "in every parameter" if whole else f"in {listing(fleet.unlike)}"
        yield Code.UNLIKE_FLEET.says(
            f"this robot is unlike the {fleet.robots} robots of its fleet {extent}: the fleet's prior was not used"
            " there, so more poses are needed; look for a repair, a crash, another model or another convention"
        )


def _deviations(fit: Fit) -> Iterator[tuple[Parameter, float]]:
    """Yield each free parameter with an expected error, and its deviation over the allowed one."""
    known, free = fit.nominal.parameters, fit.unknowns.index
    parameters, distances = list(known), np.abs(fit.robot.values - known.expected_si)[free] / known.sigma_si[free]
    numbers = (free, distances, fit.statistics.std, fit.statistics.data_share)
    for k, away, std, share in zip(*(of.tolist() for of in numbers), strict=True):
        parameter = parameters[k]
        if (parameter.placement and not parameter.prior) or parameter.family:  # a family's size is found
            continue
        if parameter.prior:
            yield parameter, away / float(np.sqrt(max(share, SMALLEST_SHARE)))
        else:
            yield parameter, away - 2.0 * std / parameter.sigma_si


def hardly_determined(fit: Fit) -> Iterator[Reason]:
    """Report free parameters that count as determined only because of the threshold, and angles that hardly are."""
    rank = fit.determination.together
    if rank.unclear:
        yield Code.RANK_UNCLEAR.says(
            f"{rank.doubt}: one combination of parameters is hardly determined. Hold one more parameter (`calib check`"
            " names it), or measure other poses"
        )
    parameters = list(fit.nominal.parameters)
    free = [parameters[k] for k in fit.unknowns.index.tolist()]
    loose = [
        f"{p.name} (+-{quantity_text(std, 'deg', '.1f')})"
        for p, std in zip(free, fit.statistics.std, strict=True)
        if p.dimension == "angle" and std > LOOSE_ANGLE
    ]
    if loose:
        yield Code.NOT_LINEAR.says(
            f"hardly determined angles: {listing(loose)}. The model is not linear over such a range, so their intervals"
            " mean nothing. Measure poses that differ more, or hold these parameters"
        )

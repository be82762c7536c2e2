"""The verdict of new measurements on a calibrated robot: is it as accurate as expected, has it drifted, in which part?

The promise is the uncertainty that `predict` gives (`calib.core.rows.prediction.ParameterUncertainty`), and noise. The
new readings have residuals r (prediction minus read), whitened by the noise s^2 beside errors of joints and by these
errors themselves: s^2 + d^2 H_k H_k^T at pose k, with H_k the derivative by the joints. J is their derivative by what
is uncertain and lasts, u: scaled parameters, and coefficients of undecided joint terms. C is its covariance after the
calibration, and P the columns of base and targets, which are placed anew (the tracker was set up again, the reflector
screwed on again):

    r = J du + P dp + noise,      du ~ N(0, C),  dp anything,  noise ~ N(0, I)

With C = L L^T this is the least-squares problem y = X b + e of

    y = [r; 0],      X = [J L, P; I, 0],      |e|^2 = Q ~ chi^2_m,   m = readings' rows - rank P

As noise and C were found with nu degrees of freedom, Q / m is compared with F(m, nu). This counts the uncertainty of
the calibration; residuals against the noise alone would condemn every calibration. Where left-out poses were further
off than C and its noise explain (`calib.core.fitting.unseen_errors.left_out_ratio`), both are widened by as much. Where
readings of a pose scatter rho times as much as independent ones (`calib.core.numerics.clusters`), m readings count as
m / rho^2, and z is divided by rho.

Drift. A change d of one parameter, or of one joint's zero, adds its column: y = X b + B d + e. With B' the part of
[B; 0] orthogonal to X, d = B'.y / |B'|^2, and z = B'.y / |B'| is Student's t with nu degrees of freedom if nothing
changed. The smallest p-value times the number of distinct candidates (Holm's first step; parallel columns count once)
is the chance of such a z by accident. A robot has drifted if that is below the level and the rest agrees; candidates
whose z^2 is within 3.84 of the largest explain the readings about as well, and are named with it. If one change does
not explain them, the robot needs a new calibration.

Power. With n poses a change d gives z the noncentrality |d| |B'|, so that the smallest change that is seen with a
chance of 90 %, or the number of poses that a given change takes, are known before anything is measured. Errors s times
as large as expected are seen with that chance if s^2 times the 10 % point of F(m, nu) reaches its limit: 1.6 times with
30 degrees of freedom, 22 times with one. Readings that would not even show errors `TELLING` times as large are too few.

Unlike poses. Noise and errors of joints are mostly what the model leaves out. At poses drawn like the used ones they
differ from pose to pose, as noise does. Elsewhere, or where poses crowd together
(`calib.core.data.pose_groups.are_drawn_alike`), they may be one common error, though no larger. Then the n rows read
there count as k, the number of parameters that the calibration decided: rho^2 = 1 + n / k. And parameters may be as
uncertain there as if only k of the N rows used had decided them: N / k times C. If the readings agree then, the verdict
is about the poses. If a change is significant even then, the robot has drifted.

To settle it. At a pose of the calibration, the model has the same error now as then: so a difference there is a change
of the robot. Poses to measure again are chosen one by one, evenly spread ones of at most `MOST`: each increases the
information on the change most (its determinant, as O1 in `calib.core.numerics.observability`), with base and targets
eliminated, until the change shows with the chance `POWER`. A smaller change than was found takes more poses.

Millimetres. The mean square distance, which people read, is tested too. It sums squares of unequal expected size, so
its distribution is taken as an F with the same mean and variance. Its chance of a false alarm is 0.1 %.

Noise. Where readings that repeat a pose scatter more than promised, and the others agree with that scatter as noise,
the instrument or the robot's repeatability is worse, and no calibration helps.

When it fails. Readings far from the rest are left out first, up to one in twenty, and named. Several changes at once
are not distinguished: that is a new calibration's work.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray, evenly_spread
from calib.core.base.errors import CalibrationError, DataError, nearest
from calib.core.base.threads import one_blas_thread
from calib.core.data.in_memory import MeasurementsLike, PosesLike, as_measurements, as_poses
from calib.core.data.pose_groups import pose_labels
from calib.core.fitting.error_sets import ErrorSet
from calib.core.fitting.fitted import Fit
from calib.core.fitting.outliers import numbers_by_instrument
from calib.core.judging.acceptance_system import LEVEL, POWER, Change, System, candidates, without_outliers
from calib.core.judging.promise import HasPromise, Promise
from calib.core.judging.repeatability import repeatability
from calib.core.numerics.identifiability import unit_columns

TELLING = 3.0
"""Readings are too few for a verdict if they would not show errors this many times as large as expected."""
MOST = 300
"""Largest number of poses that are examined to settle a verdict."""
_COUNTS = (8, 12, 16, 24, 32)  # numbers of poses to measure again
_NOTHING = 1e-6  # information before any pose is chosen, for columns of length 1
_SUPPORT = 3.84  # 95 % point of chi-square with one degree of freedom


@dataclass(frozen=True, eq=False, repr=False)
class Acceptance:
    """Verdict of new measurements on a calibrated robot.

    Attributes:
        verdict: `agrees`, `drifted`, `noisier`, `unlike poses`, `too few readings` or `calibrate again`.
        ratio: Root mean square whitened residual, expected 1; it decides the verdict. It weights each direction by its
            uncertainty.
        low95, high95: 95 % limits of the ratio, if the robot is as calibrated.
        detectable: Smallest ratio of real to expected errors that is seen with the chance `POWER`.
        p_value, p_drift, p_rest: Chances of so large a ratio, of so large a largest change of a single parameter, and
            of so large residuals after that change, if the robot is as calibrated.
        freedom, placed: Degrees of freedom of the ratio, and of placing base and targets.
        changes: Every candidate, the largest z first.
        alternative_changes: Significant changes that explain the readings as well as the first one, itself included.
        outliers: Labels of readings that were left out.
        errors: Prediction minus read, without the outliers, after placing unknown base and targets.
        expected_rms: Expected root mean square distance of measured from predicted positions [m]; NaN without
            positions.
        calibration_rms: Part of `expected_rms` from the uncertainty of the calibration, errors of joints included,
            without noise of the readings [m].
        limit: Distance that is exceeded in one of a thousand cases, if the robot is as calibrated [m].
        coverage_factor: Half the 95 % interval of a change, in standard deviations.
        has_unlike_poses: Whether the poses are unlike those of the calibration, and the tests allow for it. Then all
            numbers allow for errors of the model that these poses share.
        has_larger_errors: Whether errors are larger than the calibration claims, without this allowance.
        repeated_visits: Poses of the calibration to measure again for a decision; none if the verdict is settled.
    """

    verdict: str
    ratio: float
    low95: float
    high95: float
    detectable: float
    p_value: float
    p_drift: float
    p_rest: float
    freedom: int
    placed: int
    changes: tuple[Change, ...]
    alternative_changes: tuple[str, ...]
    outliers: tuple[str, ...]
    errors: ErrorSet
    expected_rms: float
    calibration_rms: float
    limit: float
    coverage_factor: float
    has_unlike_poses: bool
    has_larger_errors: bool
    repeated_visits: tuple[str, ...]

    def __repr__(self) -> str:
        return (
            f"<Acceptance: {self.verdict}; residuals {self.ratio:.3g} times those expected"
            f" ({self.low95:.3g} to {self.high95:.3g}), p {self.p_value:.2g}>"
        )

    def __str__(self) -> str:
        following = {"agrees": "go on using the robot", "too few readings": "measure more poses"}
        return (
            f"{repr(self)[1:-1]}\nInside: verdict, p_value; errors, at the new poses; changes, of which each could"
            " explain the readings; outliers\n"
            f"Next: {following.get(self.verdict, 'calib.fit(robot, data) of new measurements')}"
        )


@one_blas_thread
def verify(calibrated: Fit | HasPromise | Promise, data: MeasurementsLike, *, same_setup: bool = False) -> Acceptance:
    """Return the verdict of new measurements on a calibrated robot.

    Args:
        calibrated: The fit, or a result of `load_result`; or the `promise` of a result.
        data: Measurements that the calibration has not used; or files or data frames of them.
        same_setup: Whether unknown base and targets are where the calibration found them; else they are placed anew.

    Raises:
        InputError: The argument is not a calibration.
        DataError: Too few readings for a verdict.
        UnreachablePoseError: A pose cannot be assembled.
    """
    promise = Promise.from_calibration(calibrated)
    data = as_measurements(promise.robot, data)
    system, left_out = without_outliers(System.from_promise(promise, data, same_setup))
    outliers = tuple(data.labels[system.rows.layout.visit[k]] for k in left_out)
    if left_out:  # base and targets are placed without them too
        kept = np.setdiff1d(np.arange(system.rows.layout.n_readings), left_out)
        data = data.with_readings(numbers_by_instrument(kept, system.rows.layout))
        system = System.from_promise(promise, data, same_setup)
    verdict, unlike, larger = _verdict(system), False, system.has_larger_errors
    if verdict != "agrees":
        if system.p_drift >= LEVEL and _is_noise(system):
            verdict = "noisier"
        elif system.has_unlike_poses:
            unlike, system = True, system.with_common_error()
            verdict = "unlike poses" if system.agrees else _verdict(system)
    by_chance = [1.0 - POWER, 0.025, 0.975, 1.0 - LEVEL]
    missed, low, high, limit = np.sqrt(scipy.special.fdtri(system.independent, promise.freedom, by_chance)).tolist()
    if verdict == "agrees" and limit > TELLING * missed:
        verdict = "too few readings"
    changes, settled = system.changes, verdict in ("agrees", "noisier", "too few readings")
    return Acceptance(
        verdict,
        float(np.sqrt(system.square / system.freedom)),
        low,
        high,
        limit / missed,
        system.p_value,
        system.p_drift,
        system.p_rest,
        system.freedom,
        system.placement_rank,
        changes,
        tuple(c.name for c in changes if c.significant and c.z**2 > changes[0].z ** 2 - _SUPPORT),
        outliers,
        system.errors,
        system.expected.rms,
        system.expected.calibration_rms,
        system.expected.limit(promise.freedom),
        float(scipy.special.stdtrit(promise.freedom, 0.975)),
        unlike,
        larger,
        () if settled or not changes else _poses_that_settle(promise, changes[0]),
    )


def _verdict(system: System) -> str:
    if system.agrees:
        return "agrees"
    return "drifted" if system.p_drift < LEVEL <= system.p_rest else "calibrate again"


@one_blas_thread
def visible_changes(
    calibrated: Fit | HasPromise | Promise, poses: PosesLike, *, same_setup: bool = False
) -> tuple[Change, ...]:
    """Return the smallest change of every candidate that readings at these poses show, sorted by change over scale.

    Args:
        calibrated, same_setup: As in `verify`.
        poses: Poses to be measured, or their joint values (n, n_actuated) [m or rad].
    """
    promise = Promise.from_calibration(calibrated)
    scale = {c.name: c.scale for c in candidates(promise.robot)}
    system = System.planned(promise, poses, same_setup)
    changes = (system.with_common_error() if system.has_unlike_poses else system).changes
    nothing = [replace(change, value=np.nan, z=np.nan, p_value=np.nan) for change in changes]
    # to six digits, so that rounding decides about no order
    return tuple(sorted(nothing, key=lambda change: float(f"{change.visible / scale[change.name]:.6g}")))


@one_blas_thread
def poses_needed(
    calibrated: Fit | HasPromise | Promise, poses: PosesLike, name: str, size: float, *, same_setup: bool = False
) -> int | None:
    """Return the number of poses, from the first, that show a change with the chance `POWER`; None if all are too few.

    Args:
        calibrated, poses, same_setup: As in `visible_changes`.
        name: A parameter, or `zero of JOINT`.
        size: The change [m or rad].

    Raises:
        DataError: No such candidate, or no size.
    """
    promise = Promise.from_calibration(calibrated)
    planned = as_poses(promise.robot, poses)
    names = [c.name for c in candidates(promise.robot)]
    if name not in names:
        raise DataError(f"'{name}' is no parameter or joint zero that can change{nearest(name, names)}")
    if not (np.isfinite(size) and size != 0):
        raise DataError(f"change of '{name}': {size:g} is not a change; give a number other than zero")

    def shows(n: int) -> bool:
        try:
            changes = visible_changes(promise, planned.joints[:n], same_setup=same_setup)
        except DataError:  # too few to judge anything
            return False
        return any(c.name == name and c.visible <= abs(size) for c in changes)

    needed = 1 + bisect_left(range(1, len(planned) + 1), True, key=shows)  # more poses show more
    return needed if needed <= len(planned) else None


def _is_noise(system: System) -> bool:
    """Whether repeats scatter more than expected, and the readings agree with as much noise."""
    scatter, freedom = repeatability(system.errors)
    promise = system.promise
    positions = {(i.group, part.name) for i in promise.robot.instruments for part in i.parts if part.is_position}
    sigma = [size for key, size in promise.sigma.items() if key in positions]
    if freedom == 0 or len(sigma) != 1 or sigma[0] <= 0:
        return False
    more = (scatter / sigma[0]) ** 2
    if scipy.special.fdtrc(freedom, promise.freedom, more) >= LEVEL:
        return False
    return bool(scipy.special.fdtrc(system.independent, freedom, system.square / system.freedom / more) >= LEVEL)


def _poses_that_settle(promise: Promise, change: Change) -> tuple[str, ...]:
    """Return the names of poses of the calibration that show a found change, best first; none if no poses show it."""
    if not len(promise.joints):
        return ()
    first = np.unique(pose_labels(promise.joints), return_index=True)[1]
    some = np.sort(first)[evenly_spread(len(first), MOST)]
    try:
        order = some[_order(promise, promise.joints[some], change)]
        for count in _COUNTS:
            system = System.planned(promise, promise.joints[order[:count]], same_setup=False)
            shown = {own.name: own.visible for own in system.changes}
            if shown.get(change.name, np.inf) <= abs(change.value) or count >= len(order):
                break
    except CalibrationError:  # poses cannot be simulated, such as those of setups
        return ()
    return tuple(promise.names[k] for k in order[:count])


def _order(promise: Promise, joints: FloatArray, change: Change) -> IntArray:
    system = System.planned(promise, joints, same_setup=False)
    number = [known.name for known in candidates(promise.robot)].index(change.name)
    places, layout = system.rows.jacobian[:, ~system.rows.prior.has], system.rows.layout
    columns = unit_columns(np.column_stack([places, system.candidate_columns[:, number]]))[0]
    visit = layout.visit[layout.reading]
    rows = [columns[visit == k] for k in range(len(joints))]
    information, chosen = _NOTHING * np.eye(columns.shape[1]), list[int]()
    for _ in range(min(_COUNTS[-1], len(rows))):
        inverse = np.linalg.inv(information)
        gain = [np.linalg.slogdet(np.eye(len(own)) + own @ inverse @ own.T)[1] for own in rows]
        gain = [-np.inf if k in chosen else round(float(size), 9) for k, size in enumerate(gain)]
        chosen.append(int(np.argmax(gain)))
        information = information + rows[chosen[-1]].T @ rows[chosen[-1]]
    return np.array(chosen, dtype=np.intp)

"""Rules of the verdict about the measurements: poses, outliers, repeats, digits. Each gives at most a few reasons.

Readings that stand in a file more than once. A copy has the joint values and the readings of another visit, to the
last digit. Honest repeats may have them, too, where readings are written in coarse steps: with a step d and a scatter
s of each reading, two are equal with a chance of about d / (2 sqrt(pi) s). The step is the largest one that divides all
readings; the scatter is that of repeats that differ, and at least that of the best instruments and robots. Visits are
copies where chance does not explain so many.

When it fails. Readings in steps as coarse as they scatter say nothing: copies of these are not seen.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import combinations

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.units import ERROR_UNIT, Dimension, quantity_text
from calib.core.base.words import count_noun, joints_named, listing
from calib.core.data.measurements import Measurements
from calib.core.data.pose_groups import SAME_JOINTS, pose_labels
from calib.core.fitting.fitted import Fit
from calib.core.fitting.likely_mistakes import equal_columns, zero_visits, zeros_in_words
from calib.core.fitting.outliers import outliers_in_words, studentise_errors
from calib.core.fitting.pose_checks import tied_joints, unmoved_joints
from calib.core.fitting.unseen_errors import moved_frame
from calib.core.judging import findings
from calib.core.judging.reasons import Answer, Code, Reason
from calib.core.judging.repeatability import pose_error_over_repeatability
from calib.core.judging.rounded_joint_values import rounding
from calib.core.numerics.chances import FALSE_ALARM, UNLIKELY
from calib.core.numerics.losses import HIGH_LEVERAGE
from calib.core.numerics.tall import Span
from calib.core.robots.robot import Robot

FEW = 10.0 - 1e-6  # ten, also where rounding took a little
"""With fewer degrees of freedom, intervals are very wide."""
FEW_SHARED = 5
"""With fewer degrees of freedom of the poses, intervals are very wide if the readings of a pose share errors. Distances
of targets mean something from so many poses."""
RIGID = 1e-6
"""If the distance of two targets scatters by less [m], it was computed: no instrument has read both targets."""
COSTLY = 0.36
"""If outliers make this part of the squared residuals, errors are a fifth smaller without them."""
FEW_OF = 0.01
"""Part of the validation readings that may be outliers without an effect on the grade."""
EXCLUDED = 0.1
"""Part of the poses, or of the readings, that may be outliers."""
BEYOND_REPEATS = 1.5
"""If the found noise is more than this many times the scatter of repeats, something systematic remains."""
ROUNDED = 0.2
"""Steps of the joint values are named if they make more than this part of the noise variance."""
ALL_ROUNDED = 2.0
"""If steps would make more than this part, the joints really stood at these round values."""
COPIED = 0.03
"""Part of the readings that may be copies of others."""
FAR = 3.0
"""A reading of 0, 0, 0 is an empty one, and not the frame's origin, if its residual is this many times the median."""
USED_FOR_BOTH = 0.1
"""Largest part of the validation poses that may repeat poses of the fit."""
ANOTHER = {"load": 0.05, "temperature": 2.0}
"""Measurements at the same joint values are no repeats if a stated condition differs by more than this [kg, K]."""
_SCATTER: dict[Dimension | None, float] = {"length": 5e-6, "angle": 1e-5, "pixel": 0.02}
"""Scatter of the readings of the most repeatable robots [m, rad, px]."""
_DIGIT = 1e-3  # steps below this part of this scatter make no difference


def poses_that_say_little(fit: Fit) -> Iterator[Reason]:
    """Look for joints that never moved, and poses near a singularity."""
    data = fit.identification.data
    still = unmoved_joints(fit.nominal, data.joints)
    if len(still) == len(fit.nominal.joint_names):
        yield Code.POSES_EQUAL.says(
            "all poses are the same, so the parameters come from their priors alone; move the robot"
        )
    elif still:
        yield Code.JOINT_NEVER_MOVED.says(
            f"{joints_named(*still, shown=len(still))} never moved: poses that move"
            f" {'it' if len(still) == 1 else 'them'} are not calibrated"
        )
    tied = tied_joints(fit.nominal, data.joints)
    n_moved = len(fit.nominal.joint_names) - len(still)
    unseen = sum(len(names) - count for names, count in tied)
    if unseen > max(n_moved - (len(data) - 1), 0):  # fewer poses than joints cannot show more
        groups = [f"{joints_named(*names)} along {count_noun(count, 'direction')}" for names, count in tied]
        yield Code.JOINTS_MOVE_TOGETHER.says(
            f"joints moved only together: {listing(groups, '; ')}. The error of each of them alone comes from priors."
            " Move each of these joints by itself"
        )
    limit = fit.nominal.description.singularity_limit
    near = [data.labels[k] for k in np.flatnonzero(fit.identification.singular_value < limit)]
    if near:
        yield Code.NEAR_SINGULAR.says(
            f"{count_noun(len(near), 'pose is', 'poses are')} near a singularity of the loops (smallest singular value"
            f" below {limit:g}): {listing(near)}; leave {'it' if len(near) == 1 else 'them'} out"
        )


def too_few_poses(fit: Fit) -> Iterator[Reason]:
    """Count degrees of freedom, for which only validation at other poses makes up, and poses that share errors."""
    statistics, rows, used = fit.statistics, fit.rows.layout.n_read, fit.statistics.effective_parameters
    if statistics.freedom < FEW or rows < 2 * used - 1e-6:
        yield Code.TOO_FEW_POSES.says(
            f"too few poses: {rows} measured values for {used:.0f} parameters. Measure several times as many poses",
            counted=statistics.freedom >= FEW and fit.validation is not None,
        )
    shared = statistics.shared_scatter
    if shared is not None and shared.chance < UNLIKELY and statistics.interval_freedom < FEW_SHARED:
        yield Code.TOO_FEW_POSES.says(
            "too few poses: the readings of a pose share errors, so that intervals come from only"
            f" {statistics.interval_freedom:.1f} independent errors. Measure several times as many poses, not more"
            " readings of each pose"
        )


def moves_as_one(fit: Fit) -> Iterator[Reason]:
    """Look for targets with such constant distances that they were computed from one pose."""
    data, names = fit.identification.data, fit.nominal.target_names
    if len(names) < 2 or fit.computed:
        return
    points = data.points(fit.nominal)
    rigid = set()
    for a, b in combinations(range(len(names)), 2):
        distances = np.linalg.norm(points[:, a] - points[:, b], axis=1)
        distances = distances[np.isfinite(distances)]
        if len(distances) >= FEW_SHARED and np.std(distances) < RIGID < fit.sigma:
            rigid |= {names[a], names[b]}
    if rigid:
        yield Code.MOVES_AS_ONE.says(
            f"the distances between targets {listing([name for name in names if name in rigid])} are the same at every"
            f" pose, to {quantity_text(RIGID, 'um', 'g')}, while readings are off by {quantity_text(fit.sigma, 'mm')}"
            " per axis: these targets were computed from one measured pose. Intervals count each pose once. Give that"
            " pose itself, with an instrument of kind pose"
        )


def outliers(fit: Fit) -> Iterator[Reason]:
    """List outliers, and count the excluded ones. Where a frame moved, all readings from there look like outliers."""
    for where, outlying in (
        ("", findings.outliers(fit)),
        (" among the poses that were not used", findings.validation_outliers(fit)),
    ):
        if outlying and not (where and moved_frame(fit)):
            rows = fit.validation_rows if where else fit.rows
            assert rows is not None  # of which some readings are outliers
            squares = rows.distances() ** 2
            gone = float(np.sum(squares[[outlier.reading for outlier in outlying]]))
            few = bool(where) and len(outlying) <= FEW_OF * rows.layout.n_readings
            words = listing(outliers_in_words(outlying), "; ", 2)
            yield Code.OUTLIERS.says(
                f"{count_noun(len(outlying), 'outlier')}{where} (chance below {100 * FALSE_ALARM:g} %): {words};"
                f" look at {'this measurement' if len(outlying) == 1 else 'these measurements'}"
                + ("" if where else f"; --exclude-outliers fits without {'it' if len(outlying) == 1 else 'them'}"),
                counted=few or gone < COSTLY * max(float(np.sum(squares)), 1e-300),
                answer=Answer.LOOK if where else None,
            )
    if fit.with_all is not None:
        counts = [(len(each.identification.data), each.rows.layout.n_readings) for each in (fit.with_all, fit)]
        for total, kept, what in zip(*counts, ("poses", "readings"), strict=True):
            if total - kept > EXCLUDED * total:
                yield Code.MANY_EXCLUDED.says(
                    f"{total - kept} of {total} {what} were excluded: so many cannot be outliers; the model or the"
                    " measurements are wrong"
                )
                return


def used_twice(fit: Fit) -> Iterator[Reason]:
    """Look for validation poses that the fit has used, and readings that are in the data twice, to the last digit."""
    sets = [fit.identification.data, *([] if fit.validation is None else [fit.validation.data])]
    used, total = sets[0], sum(map(len, sets))
    for other in sets[1:]:
        label = pose_labels(np.vstack([_state(used), _state(other)]))
        same_pose = np.isin(label[len(used) :], label[: len(used)])
        known = {key for keys in reading_keys(used, np.arange(len(used))) for key in keys}
        n_same = sum(bool(keys & known) for keys in reading_keys(other, np.flatnonzero(same_pose)))
        if n_same or np.sum(same_pose) > USED_FOR_BOTH * len(other):
            overlap = "are measurements that the fit has used" if n_same else "were measured at poses of the fit"
            yield Code.USED_FOR_BOTH.says(
                f"{n_same or np.sum(same_pose)} of {count_noun(len(other), 'validation pose')} {overlap}: they"
                " prove little; validate with other poses"
            )
    copies = [] if fit.computed else [data.labels[k] for data in sets for k in copied_visits(fit.nominal, data)]
    if copies and len(copies) >= COPIED * total:
        yield Code.COPIED.says(
            f"{len(copies)} of {count_noun(total, 'reading')} are copies of others to the last digit, so intervals are"
            f" too narrow: {listing(copies)}. Leave the copies out"
        )


def doubtful_readings(fit: Fit) -> Iterator[Reason]:
    """Report what the instruments find wrong with their readings.

    A fit bends the robot until such readings fit, and left-out readings of the same files agree: only another kind of
    instrument can confirm the result.
    """
    readings_of = fit.identification.data.readings
    instruments = {name: fit.nominal.instrument(name) for name in readings_of}
    doubts = {name: instruments[name].doubts(readings) for name, readings in readings_of.items()}
    doubted = {type(instruments[name]) for name, texts in doubts.items() if texts}
    alone = doubted.issuperset(type(instrument) for instrument in instruments.values())
    for texts in doubts.values():
        for text in texts:
            yield Code.DOUBTFUL_READINGS.says(text, grade="FAIL" if alone else None)


def _state(visits: Measurements) -> FloatArray:
    """Joints, setup and stated conditions of visits, (n, ...), in units of a difference that counts."""
    nothing = np.zeros(len(visits))
    stated = [SAME_JOINTS / size * np.nan_to_num(visits.context.get(name, nothing)) for name, size in ANOTHER.items()]
    return np.column_stack([visits.joints, nothing if visits.setups is None else visits.setups, *stated])


def dead_readings(fit: Fit) -> Iterator[Reason]:
    """Look for readings that no instrument took: exactly 0, 0, 0 and far off, and columns that are copies."""
    data = fit.identification.data
    zeros = zero_visits(data, fit.nominal)
    left = np.zeros(len(data))
    np.maximum.at(left, fit.rows.layout.visit, fit.rows.distances())
    if len(zeros) > 1 or np.any(left[zeros] > FAR * np.median(left)):  # one may be the origin of the frame
        yield Code.ZERO_READINGS.says(zeros_in_words(data, fit.nominal))
    for first, second in equal_columns(data, fit.nominal):
        yield Code.EQUAL_COLUMNS.says(
            f"columns {first} and {second} are equal in every row: one is a copy of the other; export the file again"
        )


def repeats(fit: Fit) -> Iterator[Reason]:
    """Compare residuals with the scatter of repeats."""
    ratio, p_value = pose_error_over_repeatability(fit.identification, fit.statistics.effective_parameters)
    if ratio > BEYOND_REPEATS and p_value < UNLIKELY:
        yield Code.REPEATABILITY.says(
            f"means of repeats are off by {ratio:.1f} times what their scatter explains: the model leaves something"
            " out, or the repeats were read without moving the robot"
        )


def check_rounding(fit: Fit) -> Iterator[Reason]:
    """Report joint values that were rounded so coarsely that this makes much of the noise."""
    steps, share, chance = (None if fit.computed else rounding(fit)) or ("", 0.0, 1.0)
    if ROUNDED < share < ALL_ROUNDED and chance < FALSE_ALARM:
        noise, part = fit.first_noise.sigma * float(np.sqrt(min(share, 1.0))), fit.first_noise.group.part
        yield Code.ROUNDED.says(
            f"joint values were rounded to steps of {steps}, which makes about"
            f" {quantity_text(noise, ERROR_UNIT[part.dimension], '.2g')} of noise. Export joint values with all digits"
            " of the controller"
        )


def leverage(fit: Fit) -> Iterator[Reason]:
    """List poses that decide their own prediction, curves aside.

    A curve follows each pose a little; an error at any of them has only a local effect.
    """
    deciding = studentise_errors(fit).largest_leverage > HIGH_LEVERAGE
    lasting = fit.unknowns.family < 0
    if np.any(deciding) and not np.all(lasting):
        rows = fit.rows.select_parameters(lasting)
        span = Span(rows.jacobian, rows.with_weights(fit.weights).posterior_information.root)
        deciding &= rows.studentise(span, fit.weights, fit.statistics.freedom).largest_leverage > HIGH_LEVERAGE
    visits = dict.fromkeys(fit.rows.layout.visit[np.flatnonzero(deciding)].tolist())
    high = [fit.identification.data.labels[k] for k in visits]
    if high and fit.statistics.freedom >= FEW:
        yield Code.LEVERAGE.says(
            f"{count_noun(len(high), 'pose decides its', 'poses decide their')} own prediction, so an error there would"
            f" not show: {listing(high)}; measure more poses near {'it' if len(high) == 1 else 'them'}"
        )


def copied_visits(robot: Robot, data: Measurements) -> IntArray:
    """Return the visits that are copies of earlier ones, (n,); none where chance may have made them equal."""
    joints = [values.tobytes() for values in data.joints]
    count = Counter(joints)
    repeated = np.array([visit for visit, own in enumerate(joints) if count[own] > 1], dtype=np.intp)
    first: dict[bytes, int] = {}
    known, copies, pairs = set[tuple[bytes, frozenset[bytes]]](), [], []
    for visit, keys in zip(repeated.tolist(), reading_keys(data, repeated), strict=True):
        own = joints[visit], frozenset(keys)
        if own in known:
            copies.append(visit)
        elif own[0] in first:
            pairs.append((first[own[0]], visit))
        known.add(own)
        first.setdefault(own[0], visit)
    if not copies:
        return np.zeros(0, dtype=np.intp)
    chance = _chance_of_same(robot, data, pairs)
    sure = bool(scipy.special.bdtrc(len(copies) - 1, len(copies) + len(pairs), chance) < UNLIKELY)
    return np.array(copies if sure else [], dtype=np.intp)


def _chance_of_same(robot: Robot, data: Measurements, pairs: list[tuple[int, int]]) -> float:
    """Return the chance that a repeat has the same readings, from `pairs` of unlike repeats; 0 without numbers."""
    chances = []
    for name, readings in data.readings.items():
        whole = np.full((len(data), readings.values.shape[1]), np.nan)
        whole[readings.visits] = readings.values
        for column, numbers in zip(robot.instrument(name).columns(), whole.T, strict=False):
            least = _SCATTER.get(column.dimension, 0.0)
            if least > 0.0:
                apart = np.array([numbers[a] - numbers[b] for a, b in pairs])
                apart = apart[np.isfinite(apart)]
                scatter = max(least, float(np.sqrt(np.mean(apart**2) / 2)) if len(apart) else 0.0)
                known = np.unique(numbers[np.isfinite(numbers)])
                digits = np.round((known - known[:1]) / (_DIGIT * least)).astype(np.int64)
                step = _DIGIT * least * float(np.gcd.reduce(digits))  # largest one that divides all, up to rounding
                chances.append(step / (2 * np.sqrt(np.pi) * scatter) if step < scatter else 1.0)
    return float(np.prod(chances)) if chances else 0.0


def reading_keys(data: Measurements, visits: IntArray) -> list[set[bytes]]:
    """Return keys of the readings at some visits (n,), equal where the readings are equal to the last digit."""
    place = np.full(len(data), -1)
    place[visits] = np.arange(len(visits))
    keys: list[set[bytes]] = [set() for _ in range(len(visits))]
    for name, readings in data.readings.items():
        of_these = place[readings.visits] >= 0
        parts = (readings.visits, readings.values, readings.details)
        for visit, values, details in zip(*(part[of_these] for part in parts), strict=True):
            keys[place[visit]].add(name.encode() + values.tobytes() + details.tobytes())
    return keys

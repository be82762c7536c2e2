"""The robots of a fit's files: for each kind of file the best that it can hold
(`calib.core.robots.accuracy_of_files`).

A file that loses joint terms gets the robot that the same measurements give without them: fitted again, from the
nominal robot, to the same visits (without excluded outliers), with the same noise, loss, starts and folds. So its
origins take up as much as they can of the terms' effects, and its covariance counts the rest as noise. The others are:
the nominal robot with joint zeros alone, base and targets placed with them; and the robot with nominal origins behind
the last axis.

A robot is withheld if its fit did not converge, or if it is worse than the nominal robot, with only base and targets
placed, at the poses of `calib.core.fitting.unseen_errors`. A larger root mean square error is enough, beyond chance or
not: the nominal robot exists already and costs nothing, so the new one must prove itself.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import replace

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import CalibrationError
from calib.core.base.threads import one_blas_thread
from calib.core.base.workers import Workers
from calib.core.calibrating.calibrate import PROVING
from calib.core.fitting.fit import WarmStart, fit_data, fit_of_a_part
from calib.core.fitting.fitted import Fit
from calib.core.fitting.settings import Settings
from calib.core.fitting.solved_fit import COMPUTED
from calib.core.fitting.unseen_errors import accuracy
from calib.core.fitting.validation import cross_validate, n_folds
from calib.core.judging.verdict import JudgedFit
from calib.core.robots.accuracy_of_files import Accuracy, FileRobot, Holds
from calib.core.robots.joint_errors import actual_joints
from calib.core.robots.robot import Robot
from calib.core.robots.robot_files import lost_by, without_terms
from calib.core.robots.terms.one_coefficient import Zero
from calib.core.robots.terms.term import Joint, TermSection

_NOTHING = 1e-12  # joint zero, or squared motion of joints, that counts as none [m or rad]
_SAME = 1.0 + 1e-6  # an error up to this many times the nominal one, plus `COMPUTED`, differs from it by rounding only


@one_blas_thread
def with_files(fit: Fit, settings: Settings, executor: Executor | int | None = None) -> JudgedFit:
    """Return a fit with the robots of its files.

    Fits without joint terms are done at once; other robots are found at first use.

    Args:
        executor: Executor of the fits of other starts and of folds, as in `calib.core.calibrating.calibrate.calibrate`.
    """
    started, reduced = time.perf_counter(), dict[Holds, Fit]()
    kinds = [holds for holds in (Holds.TABLES, Holds.ORIGINS) if lost_by(fit.robot, holds)]
    n_tasks = max(settings.starts - 1, n_folds(fit.identification.data, settings.folds))
    with Workers(executor if kinds else None, n_tasks) as workers:
        for holds in kinds:
            robot = start_of(fit, holds)
            if robot.terms or holds is Holds.ORIGINS:
                with suppress(CalibrationError):  # then there is no such file, and asking for one is an error
                    reduced[holds] = _refit(fit, robot, settings, workers)
    fit = replace(fit, reduced=reduced, seconds=fit.seconds + time.perf_counter() - started)
    return JudgedFit.from_fit(replace(fit, robot=replace(fit.robot, files=FitFiles(fit, settings))))


def start_of(fit: Fit, holds: Holds) -> Robot:
    """Return the nominal robot of a fit, without the joint terms that files of this kind lose.

    If terms are lost, all values become nominal again, because those of an earlier result were found with its terms.
    """
    robot = without_terms(fit.nominal, holds)
    return robot.with_nominal_values() if lost_by(fit.nominal, holds) else robot


def _refit(
    fit: Fit,
    robot: Robot,
    settings: Settings,
    workers: Executor | None = None,
    signs: FloatArray | None = None,
    *,
    ranks: bool = True,
) -> Fit:
    """Fit another robot to the measurements of a fit, with the same options.

    `signs` are those of the joint values, (n_actuated,); `ranks` says whether ranks of held parameters are used.
    """
    data, validation = fit.identification.data, None if fit.validation is None else fit.validation.data
    nearby = replace(WarmStart.from_fit(fit), free_alone=not ranks)
    if signs is not None and np.any(signs < 0):
        data = replace(data, joints=signs * data.joints)
        validation = None if validation is None else replace(validation, joints=signs * validation.joints)
    again = fit_data(robot, settings, data, validation, workers, nearby=nearby)
    if fit.folds is None:
        return again
    count = settings.folds or PROVING
    return replace(again, folds=cross_validate(data, count, settings.seed, fit_of_a_part(again, settings), workers))


class FitFiles(Mapping[Holds, FileRobot]):
    """The existing robots of a fit's files, each found at first use."""

    def __init__(self, fit: Fit, settings: Settings) -> None:
        self._fit, self._settings = fit, settings
        self._known: dict[Holds, FileRobot | None] = {}

    def __getitem__(self, holds: Holds) -> FileRobot:
        if holds not in self._known:
            self._known[holds] = None
            with suppress(CalibrationError):
                self._known[holds] = self._robot_of(holds)
        robot = self._known[holds]
        if robot is None:
            raise KeyError(holds)
        return robot

    def __iter__(self) -> Iterator[Holds]:
        return (holds for holds in Holds if self.get(holds) is not None)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __reduce__(self) -> tuple[type, tuple[dict[Holds, FileRobot]]]:
        return dict, (dict(self),)  # a robot that goes to other processes takes no measurements along

    @one_blas_thread
    def _robot_of(self, holds: Holds) -> FileRobot | None:
        if holds is Holds.ZEROS:
            return self._zeros()
        if holds is Holds.TO_LAST_AXIS:
            return self._to_last_axis()
        if not lost_by(self._fit.robot, holds):
            return replace(file_robot(self._fit), values=without_terms(self._fit.robot, holds).values_by_name)
        fitted = (self._fit.reduced or {}).get(holds)
        return None if fitted is None else file_robot(fitted)

    def _refit(self, robot: Robot, signs: FloatArray | None = None) -> Fit:
        return _refit(self._fit, robot, replace(self._settings, starts=1), signs=signs, ranks=False)

    def _to_last_axis(self) -> FileRobot | None:
        start = start_of(self._fit, Holds.ORIGINS)
        behind = behind_last_axis(start)
        nominal = {
            p.name: p.nominal_si
            for p in start.parameters
            if p.name.rpartition(".")[0] in behind and not p.placement and p.name not in start.description.held
        }
        if not nominal:
            return self.get(Holds.ORIGINS)
        return file_robot(self._refit(start.with_parameters(nominal).fix(*nominal)))

    def _zeros(self) -> FileRobot:
        nominal, signs = without_terms(self._fit.nominal, Holds.ZEROS).with_nominal_values(), self._signs()
        fitted = self._refit(with_zeros(nominal), signs)
        offsets = fitted.robot.values[fitted.robot.coefficients]
        offsets = np.where(np.abs(offsets) < _NOTHING, 0.0, offsets)  # base and targets have taken up these errors
        return replace(file_robot(fitted), values={}, signs=signs, offsets=offsets)

    def _signs(self) -> FloatArray:
        """Signs of the joints, (n_actuated,): -1 where one moves against its commands."""
        fit, commands = self._fit, self._fit.identification.data.joints
        actual = actual_joints(fit.robot, commands, fit.configurations.term_columns)[:, : commands.shape[1]]
        moved, errors = commands - commands.mean(axis=0), actual - commands
        return np.where(np.sum(moved * errors, axis=0) < -np.sum(moved**2, axis=0) - _NOTHING, -1.0, 1.0)


def with_zeros(nominal: Robot) -> Robot:
    """Return a robot of which a fit may change only the joints' zeros, base, targets and instruments."""
    origins = nominal.parameters[: nominal.n_origin_parameters]
    terms = []
    for name in nominal.joint_names:
        dimension = nominal.mechanism.dimensions[name]
        expected = max((p.sigma_si for p in origins if p.dimension == dimension and not p.placement), default=None)
        section = TermSection(joint=name, term=Zero.word)
        terms.append(Zero.from_section(Joint(name, dimension, nominal.joint_names), section, expected))
    robot = replace(nominal, terms=tuple(terms), values=np.append(nominal.values, np.zeros(len(terms))))
    return robot.fix(*(p.name for p in origins if not p.placement))


def file_robot(fit: Fit) -> FileRobot:
    """Return the robot of a fit for files that hold the whole model.

    If only places were free, it is the nominal robot, and counts as no worse than that.
    """
    reached = accuracy(fit)
    why = "" if np.all(fit.unknowns.placement) else why_withheld(reached)
    if not fit.converged:
        why = f"its fit did not converge: {fit.message}"
    return FileRobot(fit.robot.values_by_name, reached, why)


def why_withheld(reached: Accuracy) -> str:
    """Return why a robot of this accuracy must not replace the nominal one; empty if it may."""
    if reached.rms <= _SAME * reached.before + COMPUTED:
        return ""
    rms, before = reached.in_unit(reached.rms), reached.in_unit(reached.before)
    return f"it is worse than the nominal robot: {rms} RMS, and {before} for the nominal one ({reached.pose_words})"


def behind_last_axis(robot: Robot) -> frozenset[str]:
    """Return the names of the joint origins between the last joint with a motor and the first target that it moves."""
    target = (*robot.mechanism.moved_targets, robot.mechanism.targets[0])[0]
    parent = {joint.child: joint for joint in robot.urdf.joints}
    link, names = robot.description.targets[target.name].frame, set[str]()
    while link in parent and parent[link].name not in robot.joint_names:
        names.add(parent[link].name)
        link = parent[link].parent
    return frozenset(names)

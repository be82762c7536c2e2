"""Check of a fit's statistics by many calibrations: bias, scatter, coverage and chi-square."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.parameter import Parameter
from calib.core.base.units import millimetres, quantity_text
from calib.core.base.words import as_data, count_noun, data_frame, listing, plain_text, text_table

_TAIL = 0.05  # probability of both tails of chi-square together
_SURE = 4.0  # a difference of more standard deviations is no chance
_SCREEN = 25  # most parameters whose table fits on a screen of 40 lines
_SHOWN = 10  # parameters in the table if there are more
_WIDTH = 110  # characters


@dataclass(frozen=True, eq=False)
class Draws(ReadOnlyArrays):
    """Results of draws, a row for each that has an answer.

    Attributes:
        truth: True values of the free parameters, (n, n_free) [m or rad]; NaN if the truth has no such parameter.
        values: Estimates, (n, n_free).
        std: Their claimed standard deviations, (n, n_free).
        half_width: Half the claimed 95 % intervals, (n, n_free).
        sigma: Estimated noise of each group of rows, (n, n_groups) [SI].
        chi_square: Sum of squares of the residuals, in units of the stated noise, (n,).
        freedom: Degrees of freedom, (n,).
        names_outliers: 1 if the fit named an outlier, else 0, (n,).
        errors: Predicted minus true positions at unmeasured poses, (n, n_poses, n_targets, 3) [m].
        error_half_width: Half their claimed 95 % intervals, (n, n_poses, n_targets, 3) [m].
    """

    truth: FloatArray
    values: FloatArray
    std: FloatArray
    half_width: FloatArray
    sigma: FloatArray
    chi_square: FloatArray
    freedom: FloatArray
    names_outliers: FloatArray
    errors: FloatArray
    error_half_width: FloatArray

    def __len__(self) -> int:
        return len(self.values)

    @staticmethod
    def join(parts: Sequence[Draws]) -> Draws:
        """Return the draws of several parts in one."""
        return Draws(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Draws)))


@dataclass(frozen=True)
class ParameterStudy:
    """A free parameter over all draws.

    Attributes:
        name: Its name.
        unit: Unit of its numbers.
        bias: Mean of value minus truth.
        bias_std: Standard deviation of that mean.
        spread: Standard deviation of value minus truth.
        claimed: Root mean square of the claimed standard deviations.
        coverage: Part of the draws whose 95 % interval contains the truth.
    """

    name: str
    unit: str
    bias: float
    bias_std: float
    spread: float
    claimed: float
    coverage: float


@dataclass(frozen=True, eq=False, repr=False)
class Study(ReadOnlyArrays):
    """Many calibrations of one robot.

    Attributes:
        robot: Name of the robot.
        free: The free parameters.
        groups: Names of the groups of rows, in the order of `draws.sigma`.
        draws: Results of the draws with an answer.
        failures: Reasons of the draws without an answer.
        n_poses: Number of measured poses.
        seed: Seed of all random numbers.
        seconds: Duration of the whole computation.
        resampled: Whether poses of real measurements were resampled; else everything is simulated.
    """

    robot: str
    free: tuple[Parameter, ...]
    groups: tuple[str, ...]
    draws: Draws
    failures: tuple[str, ...]
    n_poses: int
    seed: int
    seconds: float
    resampled: bool

    def __repr__(self) -> str:
        return f"<study of '{self.robot}': {len(self)} calibrations, {len(self.failures)} without an answer>"

    def __str__(self) -> str:
        return self.report()

    def __len__(self) -> int:
        return len(self.draws) + len(self.failures)

    @property
    def parameters(self) -> tuple[ParameterStudy, ...]:
        """Every free parameter over all draws with an answer."""
        draws, n = self.draws, len(self.draws)
        error = draws.values - draws.truth
        spread = np.std(error, axis=0, ddof=1) if n > 1 else np.full(len(self.free), np.nan)
        claimed = np.sqrt(np.mean(draws.std**2, axis=0))
        covered = np.where(np.isnan(error), np.nan, np.abs(error) <= draws.half_width)
        columns = (np.mean(error, axis=0), spread / np.sqrt(n), spread, claimed, np.mean(covered, axis=0))
        scale = np.array([[parameter.per_si] * 4 + [1.0] for parameter in self.free])  # a coverage has no unit
        return tuple(
            ParameterStudy(parameter.name, parameter.unit, *map(float, numbers))
            for parameter, numbers in zip(self.free, scale * np.stack(columns, axis=1), strict=True)
        )

    @property
    def position_coverage(self) -> FloatArray:
        """Part of the draws whose 95 % interval contains the truth at unmeasured poses, (n_poses, n_targets, 3)."""
        return np.mean(np.abs(self.draws.errors) <= self.draws.error_half_width, axis=0)

    @property
    def position_error(self) -> float:
        """Root mean square distance of predicted from true positions at unmeasured poses [m]; NaN if there are none."""
        errors = self.draws.errors
        return float(np.sqrt(np.mean(np.sum(errors**2, axis=-1)))) if errors.size else float("nan")

    @property
    def chi_square(self) -> float:
        """Mean of chi-square over its degrees of freedom: 1 if the noise is as stated; NaN if none is stated."""
        return float(np.mean(self.draws.chi_square / self.draws.freedom))

    @property
    def chi_square_refused(self) -> float:
        """Part of the draws that a test of chi-square at 5 % rejects; NaN if no noise is stated."""
        value, freedom = self.draws.chi_square, self.draws.freedom
        tail = np.minimum(scipy.special.chdtr(freedom, value), scipy.special.chdtrc(freedom, value))
        return float(np.mean(np.where(np.isfinite(value), tail < _TAIL / 2, np.nan)))

    @property
    def outliers(self) -> float:
        """Part of the draws that name an outlier."""
        return float(np.mean(self.draws.names_outliers))

    def report(self, *, verbose: bool = False) -> str:
        """Return the study as text.

        Args:
            verbose: Whether to list all parameters; otherwise those with the lowest coverage, if all exceed a screen.
        """
        headers = ("parameter", "unit", "bias", "+-", "spread", "claimed", "spread / claimed", "coverage [%]")
        table = text_table(headers, headers[:2], plain=True)
        parameters, more = self.parameters, 0
        if not verbose and len(parameters) > _SCREEN:
            more = len(parameters) - _SHOWN
            parameters = tuple(sorted(parameters, key=lambda parameter: parameter.coverage)[:_SHOWN])
        for parameter in parameters:
            shown = (parameter.bias, parameter.bias_std, parameter.spread, parameter.claimed)
            numbers = [f"{number:.3g}" for number in shown]
            ratio = parameter.spread / parameter.claimed if parameter.claimed > 0 else float("nan")
            table.add_row(parameter.name, parameter.unit, *numbers, f"{ratio:.3f}", f"{100 * parameter.coverage:.1f}")
        rest = (
            [f"{count_noun(more, 'more parameter')} covered at least as often: --verbose prints them"] if more else []
        )
        return plain_text([*self._summary(), "", table, *rest, "", *self._findings()], _WIDTH).rstrip()

    def _summary(self) -> list[str]:
        done, poses = "simulated calibration", f"{count_noun(self.n_poses, 'pose')} each"
        if self.resampled:
            done, poses = "calibration", f"each from {self.n_poses} of its {self.n_poses} poses, with replacement"
        lines = [f"{count_noun(len(self), done)} of {self.robot}, {poses}, seed {self.seed}"]
        if self.failures:
            lines.append(f"{count_noun(len(self.failures), 'draw')} gave no answer: {listing(self.failures, '; ', 2)}")
        return lines

    def _findings(self) -> list[str]:
        chance = 100 * np.sqrt(0.95 * 0.05 / len(self.draws))
        coverage = 100 * np.array([parameter.coverage for parameter in self.parameters])
        truth = "what all poses give" if self.resampled else "the truth"
        lines = [
            f"95 % intervals contain {truth} in {_range(coverage)} % of the draws; one standard deviation of a coverage"
            f" is {chance:.1f} %"
        ]
        biased = [parameter.name for parameter in self.parameters if abs(parameter.bias) > _SURE * parameter.bias_std]
        if biased:
            lines.append(f"biased by more than chance ({_SURE:g} standard deviations): {listing(biased)}")
        if self.draws.errors.size:
            lines.append(
                f"predicted positions elsewhere: RMS error {quantity_text(self.position_error, 'mm', '.4f')}, intervals"
                f" contain {truth} in {_range(100 * self.position_coverage)} %"
            )
        if np.isfinite(self.chi_square):
            lines.append(
                f"chi-square over its degrees of freedom: {self.chi_square:.3f} on average; a test at 5 % rejects"
                f" {100 * self.chi_square_refused:.1f} % of the draws"
            )
        if not self.resampled:
            lines.append(f"{100 * self.outliers:.1f} % of the draws name an outlier")
        return lines

    def to_dataframe(self) -> Any:
        """Return a pandas table of the free parameters over all draws; `InputError` without pandas."""
        return data_frame([asdict(parameter) for parameter in self.parameters])

    def to_dict(self) -> dict[str, object]:
        """Return the study as data for JSON; parameters in the units of tables, unknown numbers None."""
        sigma = np.mean(self.draws.sigma, axis=0)
        return as_data(
            {
                "robot": self.robot,
                "draws": len(self),
                "answered": len(self.draws),
                "failures": list(self.failures),
                "n_poses": self.n_poses,
                "resampled": self.resampled,
                "seed": self.seed,
                "seconds": self.seconds,
                "parameters": [asdict(parameter) for parameter in self.parameters],
                "sigma": {name: float(value) for name, value in zip(self.groups, sigma, strict=True)},
                "chi_square": self.chi_square,
                "chi_square_refused": self.chi_square_refused,
                "outliers": self.outliers,
                "position_error_mm": millimetres(self.position_error),
                "position_coverage": self.position_coverage.tolist(),
            }
        )


def _range(percent: FloatArray) -> str:
    return f"{np.min(percent):.1f} to {np.max(percent):.1f} (mean {np.mean(percent):.1f})"

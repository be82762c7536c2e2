"""A fit that can be asked what it is worth: the findings and the verdict of `calib.judging`, as attributes."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Self

from calib.fitting.fitted import Fit
from calib.fitting.outliers import Outlier
from calib.judging import findings
from calib.judging.error_budget import ErrorBudget
from calib.judging.reasons import Verdict
from calib.judging.residual_patterns import Pattern
from calib.judging.verdict import judge
from calib.rows.known_robot import KnownRobot


@dataclass(frozen=True, eq=False, repr=False)
class JudgedFit(Fit):
    """A fit with its findings and its verdict, each made when it is first asked for."""

    with_all: JudgedFit | None = None

    @classmethod
    def of(cls, fit: Fit) -> Self:
        """Return a fit with what it is worth."""
        values = {field.name: getattr(fit, field.name) for field in fields(fit)}
        if fit.with_all is not None:
            values["with_all"] = JudgedFit.of(fit.with_all)
        if fit.reduced is not None:
            values["reduced"] = {holds: JudgedFit.of(other) for holds, other in fit.reduced.items()}
        return cls(**values)

    def __repr__(self) -> str:
        return (
            f"<{type(self).__name__} of '{self.nominal.name}': {self.verdict.grade}, {self.identification.data.n_poses}"
            f" poses, {len(self.unknowns)} free parameters>"
        )

    @property
    def verdict(self) -> Verdict:
        """PASS, CHECK or FAIL, with reasons."""
        return judge(self)

    @property
    def outliers(self) -> tuple[Outlier, ...]:
        """Readings that were used and lie further off than noise explains, worst first."""
        return findings.outliers(self)

    @property
    def validation_outliers(self) -> tuple[Outlier, ...]:
        """Readings that were not used and lie further off than noise and uncertainty explain, worst first."""
        return findings.validation_outliers(self)

    @property
    def patterns(self) -> tuple[Pattern, ...]:
        """Systematic patterns that were looked for in the residuals, most significant first."""
        return findings.patterns(self)

    @property
    def budget(self) -> ErrorBudget | None:
        """What made the error before, and what is left; None where the robot cannot be assembled on the way."""
        return findings.budget(self)

    @property
    def known(self) -> KnownRobot:
        """The calibrated robot, with how well it is known and where it was measured."""
        joints, needless = self.identification.data.joints, self.verdict.nothing_to_correct
        return KnownRobot(self.robot, self.uncertainty, joints, needless)

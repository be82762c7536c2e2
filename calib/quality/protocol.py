"""A qualification protocol: checks in three phases, each with its requirement and its result.

The phases are those of laboratory and medical quality systems. Installation (IQ): the installed files are the released
files. Operation (OQ): the program reproduces reference results. Performance (PQ): its calibrations keep their claims.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum

from calib.core.base.errors import CalibrationError
from calib.core.base.threads import one_blas_thread
from calib.core.base.workers import Progress


class Phase(StrEnum):
    """A phase of a qualification, by its name."""

    INSTALLATION = "Installation qualification"
    OPERATION = "Operation qualification"
    PERFORMANCE = "Performance qualification"


class Outcome(StrEnum):
    """Result of a check."""

    PASS = "PASS"
    FAIL = "FAIL"
    NOTED = "NOTED"


@dataclass(frozen=True)
class Check:
    """One line of the protocol.

    Attributes:
        phase: Phase of the check.
        subject: The thing to check.
        expected: Requirement, and its source.
        found: Result in words.
        outcome: PASS or FAIL; NOTED if there is nothing to compare with.
    """

    phase: Phase
    subject: str
    expected: str
    found: str
    outcome: Outcome

    @classmethod
    def from_values(cls, phase: Phase, subject: str, expected: str, found: str, passed: bool) -> Check:
        """Return a check that passed or failed."""
        return cls(phase, subject, expected, found, Outcome.PASS if passed else Outcome.FAIL)


@dataclass(frozen=True)
class Protocol:
    """Checks of a qualification in their order, facts of the machine by name, start (ISO 8601) and duration [s]."""

    checks: tuple[Check, ...]
    machine: dict[str, str]
    started: str
    seconds: float

    @property
    def passed(self) -> bool:
        """Whether no check failed."""
        return all(check.outcome is not Outcome.FAIL for check in self.checks)

    def to_dict(self) -> dict[str, object]:
        """Return the content for JSON."""
        return {
            "outcome": "PASS" if self.passed else "FAIL",
            "started": self.started,
            "seconds": round(self.seconds, 1),
            "machine": self.machine,
            "checks": [asdict(check) for check in self.checks],
        }


Work = tuple[Phase, str, Callable[[], Iterable[Check]]]
"""A piece of work: its phase, its subject, and the function that does it."""


@one_blas_thread
def run_checks(work: Sequence[Work], progress: Progress | None = None) -> list[Check]:
    """Return the checks of all pieces of work; a piece that ends in an error gives a failed check."""
    done: list[Check] = []
    for number, (phase, subject, checks) in enumerate(work, 1):
        try:
            done.extend(checks())
        except (CalibrationError, ArithmeticError, LookupError, OSError, TypeError, ValueError, RuntimeError) as error:
            done.append(Check.from_values(phase, subject, "runs to its end", f"{type(error).__name__}: {error}", False))
        if progress is not None:
            progress(number, len(work))
    return done

"""What a verdict is made of: a grade, and reasons in words that say what to do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Grade = Literal["PASS", "CHECK", "FAIL"]
NOTHING_TO_CORRECT = "nothing_to_correct"
"""Code of the reason that the nominal values are as good as any."""


@dataclass(frozen=True)
class Reason:
    """One thing to know.

    Attributes:
        grade: CHECK or FAIL; PASS where it is good to know and no doubt.
        code: Short name for programs.
        text: What was found, and what to do.
    """

    grade: Grade
    code: str
    text: str


@dataclass(frozen=True)
class Verdict:
    """The judgement of a fit.

    Attributes:
        grade: The worst of its reasons; PASS without any.
        reasons: FAIL before CHECK before PASS.
        not_covered: What could be wrong without any trace in these measurements, in words.
    """

    grade: Grade
    reasons: tuple[Reason, ...]
    not_covered: tuple[str, ...] = ()

    def to_dict(self, *, forced: bool = False) -> dict[str, object]:
        """Return the entry of `result.json`.

        Args:
            forced: Whether a failed result was exported all the same.
        """
        entry: dict[str, object] = {
            "grade": self.grade,
            "reasons": [reason.text for reason in self.reasons],
            "codes": [reason.code for reason in self.reasons],
            "grades": [reason.grade for reason in self.reasons],
            "not_covered": list(self.not_covered),
        }
        if self.grade == "FAIL":
            entry["forced"] = forced
        return entry

"""What a verdict is made of: a grade, and reasons in words that say what to do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from calib.judging.claim import Claim

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
        counted: Whether errors at poses that were not used count what was found: where these are as claimed, and the
            robot gets better, it is no doubt, and its grade becomes PASS.
    """

    grade: Grade
    code: str
    text: str
    counted: bool = False


@dataclass(frozen=True)
class Verdict:
    """The judgement of a fit.

    Attributes:
        grade: The worst of its reasons; PASS without any.
        reasons: FAIL before CHECK before PASS.
        not_covered: What could be wrong without any trace in these measurements, in words.
        claim: How far off the robot is where it was measured; None where that is not known, or nothing is to be used.
    """

    grade: Grade
    reasons: tuple[Reason, ...]
    not_covered: tuple[str, ...] = ()
    claim: Claim | None = None

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
            "claim": None if self.claim is None else self.claim.to_dict(),
        }
        if self.grade == "FAIL":
            entry["forced"] = forced
        return entry

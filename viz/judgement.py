"""The verdict on a fit as the viewer shows it: its grade, and each reason with its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from calib import Fit
from calib.core.judging.next_step import next_step
from calib.core.judging.reasons import Code
from calib.core.judging.verdict import judge


@dataclass(frozen=True)
class Judgement:
    """A verdict to show.

    Attributes:
        grade: PASS, CHECK or FAIL.
        reasons: Grade and text of each reason; an empty grade where it is not known.
        needs_no_correction: Whether the measurements show nothing to correct.
        following: The next step, in a sentence; empty where it is not known.
    """

    grade: str
    reasons: tuple[tuple[str, str], ...]
    needs_no_correction: bool = False
    following: str = ""

    def to_dict(self) -> dict[str, object]:
        """Return the verdict as the viewer's page reads it."""
        reasons = [{"grade": grade, "text": text} for grade, text in self.reasons]
        return {"grade": self.grade, "reasons": reasons, "next": self.following}


def judgement_of_fit(fit: Fit) -> Judgement:
    """Return the verdict of a fit."""
    verdict = judge(fit)
    reasons = tuple((reason.grade, reason.text) for reason in verdict.reasons)
    return Judgement(verdict.grade, reasons, verdict.nothing_to_correct, str(next_step(fit)))


def judgement_of_result(entry: dict[str, Any], following: str = "") -> Judgement:
    """Return the verdict of a `result.json`.

    Without grades of its own, a reason has the verdict's where that is certain: a CHECK has nothing worse, and a FAIL
    begins with what made it one.

    Args:
        entry: Its entry `verdict`.
        following: Its entry `next`.
    """
    texts = entry["reasons"]
    certain = [entry["grade"] if entry["grade"] == "CHECK" or k == 0 else "" for k in range(len(texts))]
    reasons = tuple(zip(entry.get("grades", certain), texts, strict=True))
    return Judgement(entry["grade"], reasons, Code.NOTHING_TO_CORRECT in entry.get("codes", ()), following)

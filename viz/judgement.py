"""The verdict on a fit as the viewer shows it: its grade, and each reason with its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from calib.judging.reasons import Code, Verdict


@dataclass(frozen=True)
class Judgement:
    """A verdict to show.

    Attributes:
        grade: PASS, CHECK or FAIL.
        reasons: Grade and text of each reason; an empty grade where it is not known.
        no_correction: Whether the measurements show nothing to correct.
    """

    grade: str
    reasons: tuple[tuple[str, str], ...]
    no_correction: bool = False

    def to_dict(self) -> dict[str, object]:
        """Return the verdict as the viewer's page reads it."""
        return {"grade": self.grade, "reasons": [{"grade": grade, "text": text} for grade, text in self.reasons]}


def of_verdict(verdict: Verdict) -> Judgement:
    """Return the verdict of a fit."""
    reasons = tuple((reason.grade, reason.text) for reason in verdict.reasons)
    return Judgement(verdict.grade, reasons, verdict.nothing_to_correct)


def of_result(entry: dict[str, Any]) -> Judgement:
    """Return the verdict of a `result.json`.

    Without grades of its own, a reason has the verdict's where that is certain: a CHECK has nothing worse, and a FAIL
    begins with what made it one.
    """
    texts = entry["reasons"]
    certain = [entry["grade"] if entry["grade"] == "CHECK" or k == 0 else "" for k in range(len(texts))]
    reasons = tuple(zip(entry.get("grades", certain), texts, strict=True))
    return Judgement(entry["grade"], reasons, Code.NOTHING_TO_CORRECT in entry.get("codes", ()))

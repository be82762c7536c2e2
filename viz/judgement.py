"""The verdict on a fit as the viewer shows it: its grade, and each reason with its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from calib import Fit
from calib.judging.reasons import Answer, Code, Grade, what_next
from calib.judging.verdict import judge


@dataclass(frozen=True)
class Judgement:
    """A verdict to show.

    Attributes:
        grade: PASS, CHECK or FAIL.
        reasons: Grade and text of each reason; an empty grade where it is not known.
        no_correction: Whether the measurements show nothing to correct.
        following: What to do next, in a sentence; empty where that is not known.
    """

    grade: str
    reasons: tuple[tuple[str, str], ...]
    no_correction: bool = False
    following: str = ""

    def to_dict(self) -> dict[str, object]:
        """Return the verdict as the viewer's page reads it."""
        reasons = [{"grade": grade, "text": text} for grade, text in self.reasons]
        return {"grade": self.grade, "reasons": reasons, "next": self.following}


_SENTENCES = {
    Answer.LEAVE_OUT: "fit again without the outliers: calib fit with --exclude-outliers.",
    Answer.ADD_TERMS: "fit again with the joint terms that the errors ask for: calib fit with --terms auto.",
    Answer.TRY_STARTS: "fit again from several starts: calib fit with --starts 5.",
    Answer.OTHER_POSES: "ask calib check which poses are missing, measure them, and fit again.",
    Answer.VALIDATE: "see how good it is on poses that the fit has not used: calib fit with --validate 0.25.",
    Answer.LOOK: "look at the largest errors below, and at the reasons above.",
    Answer.USE: "use it: calib export writes the robot for your program, calib compensate corrects targets.",
}
_NOTHING = "keep the nominal robot: there is nothing to correct."


def _following(grade: Grade, answers: list[Answer], *, validated: bool, nothing_to_correct: bool) -> str:
    """What to do next, in a sentence."""
    following = what_next(grade, answers, validated=validated)
    return _NOTHING if following is Answer.USE and nothing_to_correct else _SENTENCES[following]


def of_fit(fit: Fit) -> Judgement:
    """Return the verdict of a fit."""
    verdict = judge(fit)
    reasons = tuple((reason.grade, reason.text) for reason in verdict.reasons)
    validated = fit.validation is not None or fit.folds is not None
    answers = [reason.answer for reason in verdict.reasons if reason.grade != "PASS"]
    nothing = verdict.nothing_to_correct
    following = _following(verdict.grade, answers, validated=validated, nothing_to_correct=nothing)
    return Judgement(verdict.grade, reasons, nothing, following)


def of_result(entry: dict[str, Any], *, validated: bool = False) -> Judgement:
    """Return the verdict of a `result.json`.

    Without grades of its own, a reason has the verdict's where that is certain: a CHECK has nothing worse, and a FAIL
    begins with what made it one. Without them, or with reasons of other packages, nobody knows what to do next.

    Args:
        entry: Its entry `verdict`.
        validated: Whether poses that were not used have judged the fit.
    """
    texts, codes = entry["reasons"], entry.get("codes", ())
    certain = [entry["grade"] if entry["grade"] == "CHECK" or k == 0 else "" for k in range(len(texts))]
    grades, following = entry.get("grades", certain), ""
    nothing, table = Code.NOTHING_TO_CORRECT in codes, {code.value: code for code in Code}
    if "grades" in entry and len(codes) == len(texts) and all(code in table for code in codes):
        answers = [table[code].answer for code, grade in zip(codes, grades, strict=True) if grade != "PASS"]
        following = _following(entry["grade"], answers, validated=validated, nothing_to_correct=nothing)
    return Judgement(entry["grade"], tuple(zip(grades, texts, strict=True)), nothing, following)

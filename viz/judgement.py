"""The verdict on a fit for the viewer, with the grade of each reason."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from calib import Fit
from calib.core.judging.next_step import DATA, ROBOT, aim_of, next_step
from calib.core.judging.reasons import Code
from calib.core.judging.rules_model import why_no_origins
from calib.core.judging.verdict import judge
from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.robot_files import lost_by


@dataclass(frozen=True)
class Judgement:
    """A verdict to show.

    Attributes:
        grade: PASS, CHECK or FAIL.
        reasons: Grade and text of each reason; an empty grade if unknown.
        needs_no_correction: Whether the measurements show nothing to correct.
        following: The next step, in a sentence; empty if unknown.
    """

    grade: str
    reasons: tuple[tuple[str, str], ...]
    needs_no_correction: bool = False
    following: str = ""

    def to_dict(self) -> dict[str, object]:
        """Return the verdict as data for the viewer's page."""
        reasons = [{"grade": grade, "text": text} for grade, text in self.reasons]
        return {"grade": self.grade, "reasons": reasons, "next": self.following}


def following_words(fit: Fit, command: str) -> str:
    """Return the next step with file names from the command line of the fit, or its aim alone if some are missing."""
    following, words = next_step(fit), shlex.split(command)
    folder = next((value for word, value in pairwise(words) if word in ("--out", "-o")), "")
    files = {ROBOT: fit.nominal.path, DATA: fit.identification.data.path}
    needed = {files[word] for word in following.command.split() if word in files}
    if not folder or not needed <= set(words):
        return aim_of(str(following))
    return following.with_file_names(files[ROBOT], [files[DATA]], folder, {})


def robot_to_load(fit: Fit) -> str:
    """Return which file of the result holds the robot, how accurate it is, or why there is none."""
    grade = judge(fit).grade
    why = "the verdict is FAIL" if grade == "FAIL" else why_no_origins(fit)
    if why:
        return f"none: {why} (--force writes calibrated.urdf)"
    lost = lost_by(fit.robot, Holds.ORIGINS)
    worth = fit.robot.files[Holds.ORIGINS].accuracy.words if lost else "as accurate as the whole model"
    doubt = "; preliminary: see Next" if grade == "CHECK" else ""
    return (
        f"calibrated.urdf: {worth}; beside this page, for simulators and ROS; for a controller: see calib export"
        f" --help{doubt}"
    )


def judgement_of_fit(fit: Fit, command: str = "") -> Judgement:
    """Return the verdict of a fit, with the next step as in `following_words`."""
    verdict = judge(fit)
    reasons = tuple((reason.grade, reason.text) for reason in verdict.reasons)
    return Judgement(verdict.grade, reasons, verdict.nothing_to_correct, following_words(fit, command))


def judgement_of_result(entry: dict[str, Any], following: str = "") -> Judgement:
    """Return the verdict of a `result.json` from its entries `verdict` and `next`.

    Without grades of its own, a reason gets the verdict's grade if that is certain: every reason of a CHECK, and the
    first reason of a FAIL.
    """
    texts = entry["reasons"]
    certain = [entry["grade"] if entry["grade"] == "CHECK" or k == 0 else "" for k in range(len(texts))]
    reasons = tuple(zip(entry.get("grades", certain), texts, strict=True))
    return Judgement(entry["grade"], reasons, Code.NOTHING_TO_CORRECT in entry.get("codes", ()), aim_of(following))

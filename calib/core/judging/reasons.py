"""The parts of a verdict: a grade, and reasons in words that say what to do.

`Code` is the table of all reasons. One function of `calib.core.judging.rules_...` holds the condition, limit and
sentence of each; `calib.core.judging.verdict` calls these functions in order.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum, StrEnum
from typing import Any, Literal, Self

from calib.core.base.other_words import HintedObject, UnknownOptionError
from calib.core.judging.claim import Claim

Grade = Literal["PASS", "CHECK", "FAIL"]


class Answer(Enum):
    """A kind of answer to a reason: see `calib.core.judging.next_step`."""

    CORRECT = "correct the data or the description"
    LEAVE_OUT = "fit without outliers"
    ADD_TERMS = "add joint terms"
    TRY_STARTS = "fit from several starting points"
    OTHER_POSES = "measure other poses"
    HOLD_OUT = "hold out poses of one file"
    STATE_NOISE = "state the noise"
    LOOK = "look at the errors"


@dataclass(frozen=True)
class Reason:
    """A finding about a fit, and its remedy.

    Attributes:
        grade: CHECK or FAIL; PASS for information without doubt.
        code: Short name for programs.
        text: The finding, and the remedy.
        counted: Whether errors at unused poses contain the effect: where these are as claimed, and the robot gets
            better, the reason raises no doubt, and its grade becomes PASS.
        answer: Kind of remedy.
    """

    grade: Grade
    code: str
    text: str
    counted: bool = False
    answer: Answer = Answer.LOOK


class Code(StrEnum):
    """Every reason: its code, grade, `counted` and answer (see `Reason`), unless its rule says otherwise."""

    # the fit as a whole
    BASE_ELSEWHERE = "base_elsewhere", "CHECK", False, Answer.CORRECT
    TARGET_ELSEWHERE = "target_elsewhere", "CHECK", False, Answer.CORRECT
    LIKELY_MISTAKE = "likely_mistake", "FAIL", False, Answer.CORRECT
    NOT_CONVERGED = "not_converged", "FAIL", False, Answer.TRY_STARTS
    NOT_ASSEMBLED = "not_assembled", "FAIL"
    WORSE_ON_VALIDATION = "worse_on_validation", "FAIL", False, Answer.OTHER_POSES
    VALIDATION = "validation", "CHECK"
    TOLERANCE = "tolerance", "CHECK", False, Answer.ADD_TERMS
    RESIDUALS_GREW = "residuals_grew", "FAIL", False, Answer.CORRECT
    INSTRUMENTS_DISAGREE = "instruments_disagree", "CHECK", False, Answer.CORRECT
    FRAME_MOVED = "frame_moved", "CHECK", False, Answer.HOLD_OUT
    NOTHING_TO_CORRECT = "nothing_to_correct", "PASS"
    NO_GAIN = "no_gain", "CHECK", False, Answer.OTHER_POSES
    FILE_WITHHELD = "file_withheld", "PASS"
    FILE_HOLDS_LESS = "file_holds_less", "PASS"
    SYSTEMATIC = "systematic", "CHECK", True, Answer.ADD_TERMS
    OTHER_MINIMUM = "other_minimum", "CHECK", False, Answer.OTHER_POSES
    # noise
    NOISE_AS_LARGE_AS_ROBOT = "noise_as_large_as_robot", "FAIL", False, Answer.CORRECT
    NO_NOISE = "no_noise", "CHECK", False, Answer.CORRECT
    NOISE = "noise", "CHECK", True, Answer.ADD_TERMS
    MISREAD = "misread", "FAIL", False, Answer.CORRECT
    # measurements
    POSES_EQUAL = "poses_equal", "FAIL", False, Answer.OTHER_POSES
    JOINT_NEVER_MOVED = "joint_never_moved", "CHECK", True, Answer.OTHER_POSES
    JOINTS_MOVE_TOGETHER = "joints_move_together", "CHECK", True, Answer.OTHER_POSES
    NEAR_SINGULAR = "near_singular", "CHECK", True
    TOO_FEW_POSES = "too_few_poses", "CHECK", False, Answer.OTHER_POSES
    MOVES_AS_ONE = "moves_as_one", "PASS"
    OUTLIERS = "outliers", "CHECK", True, Answer.LEAVE_OUT
    MANY_EXCLUDED = "many_excluded", "CHECK", False, Answer.CORRECT
    USED_FOR_BOTH = "used_for_both", "CHECK", False, Answer.HOLD_OUT
    DOUBTFUL_READINGS = "doubtful_readings", "CHECK", False, Answer.CORRECT
    COPIED = "copied", "CHECK", False, Answer.CORRECT
    ZERO_READINGS = "zero_readings", "FAIL", False, Answer.CORRECT
    EQUAL_COLUMNS = "equal_columns", "FAIL", False, Answer.CORRECT
    REPEATABILITY = "repeatability", "CHECK", True, Answer.ADD_TERMS
    ROUNDED = "rounded", "CHECK", True
    LEVERAGE = "leverage", "CHECK", True, Answer.LEAVE_OUT
    # parameters
    FAR_FROM_NOMINAL = "far_from_nominal", "FAIL"
    AT_BOUNDS = "at_bounds", "CHECK", True
    LENGTHS_SCALED = "lengths_scaled", "FAIL", False, Answer.CORRECT
    JOINT_SCALED = "joint_scaled", "CHECK", False, Answer.CORRECT
    LARGE_TERMS = "large_terms", "CHECK", True
    UNLIKE_FLEET = "unlike_fleet", "CHECK"
    RANK_UNCLEAR = "rank_unclear", "CHECK", False, Answer.OTHER_POSES
    NOT_LINEAR = "not_linear", "CHECK", False, Answer.OTHER_POSES
    # where the calibration holds
    ONE_CORNER = "one_corner", "CHECK", True, Answer.OTHER_POSES
    JOINT_MOVED_LITTLE = "joint_moved_little", "CHECK", True
    VALIDATED_ELSEWHERE = "validated_elsewhere", "CHECK", True
    BEYOND_JOINT_LIMITS = "beyond_joint_limits", "CHECK", True
    TURNS_NOT_COUNTED = "turns_not_counted", "CHECK", False, Answer.CORRECT
    BEYOND_CURVES = "beyond_curves", "CHECK", True, Answer.OTHER_POSES
    BLOCKS_DISAGREE = "blocks_disagree", "CHECK", True, Answer.ADD_TERMS
    TERMS_UNTESTED = "terms_untested", "CHECK", True, Answer.OTHER_POSES

    grade: Grade
    counted: bool
    answer: Answer

    def __new__(cls, code: str, grade: Grade, counted: bool = False, answer: Answer = Answer.LOOK) -> Self:
        """Return a code with its grade and answer, and whether it is counted."""
        row = str.__new__(cls, code)
        row._value_, row.grade, row.counted, row.answer = code, grade, counted, answer
        return row

    def says(
        self, text: str, *, grade: Grade | None = None, counted: bool | None = None, answer: Answer | None = None
    ) -> Reason:
        """Return the reason with its text; other arguments replace those of the table, and a FAIL is never counted."""
        applied = grade or self.grade
        counts = self.counted if counted is None else counted
        return Reason(applied, self.value, text, counts and applied != "FAIL", answer or self.answer)


@dataclass(frozen=True)
class Verdict(HintedObject):
    """The verdict on a fit.

    Attributes:
        grade: The worst of its reasons; PASS without any.
        reasons: FAIL before CHECK before PASS.
        not_covered: Errors that would leave no trace in these measurements, in words.
        claim: Error of the robot where it was measured; None where it is unknown, or the nominal robot is to be kept.
    """

    _other_words = "verdict"

    grade: Grade
    reasons: tuple[Reason, ...]
    not_covered: tuple[str, ...] = ()
    claim: Claim | None = None

    def __eq__(self, other: object) -> bool:
        """Whether two verdicts are equal; comparison with a text is a mistake that would go unnoticed."""
        if isinstance(other, str):
            raise UnknownOptionError(f"Verdict: is not text; write fit.verdict.grade == {other!r}")
        return isinstance(other, Verdict) and vars(self) == vars(other)

    def __bool__(self) -> bool:
        """Neither true nor false: a FAIL would be as true as a PASS."""
        raise UnknownOptionError("Verdict: is not true or false; write fit.verdict.grade == 'PASS'")

    def __str__(self) -> str:
        lines = [f"  {reason.grade}: {reason.text}" for reason in self.reasons]
        return "\n".join([self.grade, *(lines or ["  no reason against it was found"])])

    @property
    def nothing_to_correct(self) -> bool:
        """Whether the nominal values are as good as any."""
        return any(reason.code == Code.NOTHING_TO_CORRECT for reason in self.reasons)

    def to_dict(self, *, forced: bool = False) -> dict[str, object]:
        """Return the entry of `result.json`; `forced` says whether a failed result was exported nevertheless."""
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

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> Self:
        """Return the verdict of an entry of `result.json`; KeyError, TypeError or ValueError if it is damaged."""
        known = {code.value: code for code in Code}
        reasons = []
        for text, name, grade in zip(entry["reasons"], entry["codes"], entry["grades"], strict=True):
            code = known.get(name)  # reasons of other packages have their own codes
            own = Reason(grade, name, text)
            reasons.append(own if code is None else replace(own, code=code, counted=code.counted, answer=code.answer))
        claim = entry["claim"]
        claimed = None if claim is None or "dimension" not in claim else Claim.from_dict(claim)
        return cls(entry["grade"], tuple(reasons), tuple(entry["not_covered"]), claimed)

"""A robot matched to a controller: the fit, its claim, and its files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from calib.core.base.files import write_files
from calib.core.base.units import in_unit, millimetres, quantity_text
from calib.core.base.words import as_data, count_noun, json_file, plain_text
from calib.core.judging.verdict import JudgedFit
from calib.core.results.results import save
from calib.core.robots.file_formats import formats, robot_for
from calib.matching.agreement import Agreement
from calib.matching.pairs import Pairs
from calib.matching.readings import PlacedInterpretation

FILES = {"dh": "dh.csv", "mdh": "mdh.csv", "xacro": "origins.xacro", "ur-kinematics": "default_kinematics.yaml"}
"""File beside the URDF for each format."""
_WIDTH = 118
_OF_DIGITS = 2.0  # a claim up to this many times the rounding of a printed position comes from the digits


@dataclass(frozen=True)
class Match:
    """A robot matched to a controller.

    Attributes:
        fit: Joint origins, and base or tool if fitted.
        candidate: Meaning of the columns.
        pairs: The file.
        agreement: Agreement of robot and pairs.
        left_out: Names of pairs from another program, with their misses [m].
        places: Places of base and tool, in words.
        remarks: Contradictions to the file's header or to the user's statements.
        terms: Joint terms with which the controller agrees better, and the agreement with them; None if not tried.
    """

    fit: JudgedFit
    candidate: PlacedInterpretation
    pairs: Pairs
    agreement: Agreement
    left_out: tuple[tuple[str, float], ...]
    places: tuple[str, ...]
    remarks: tuple[str, ...]
    terms: tuple[str, Agreement] | None

    @property
    def grade(self) -> Literal["PASS", "CHECK", "FAIL"]:
        """PASS, CHECK or FAIL."""
        agreed = self.agreement
        if not agreed.to_the_digits:
            return "FAIL" if self.fit.verdict.grade == "FAIL" else "CHECK"
        return "CHECK" if self.left_out or agreed.claim > _OF_DIGITS * agreed.rounding_distance else "PASS"

    @property
    def conclusion(self) -> str:
        """The result in a sentence or two."""
        agreed = self.agreement
        if not agreed.to_the_digits:
            return (
                "the controller computes with something that joint origins cannot hold: the other pairs predict each"
                f" pair to {_mm(agreed.left_out)} (RMS), and the file's digits explain only"
                f" {_mm(agreed.rounding_distance)}; {self._terms_tried()}"
            )
        elsewhere = f"{_mm(agreed.claim)} and {quantity_text(agreed.turn_claim, 'mrad', '.2g')} at 95 % of all poses"
        sentence = f"agrees to {_mm(agreed.rms)} (RMS), the rounding of the file; at other poses within {elsewhere}"
        if agreed.claim > _OF_DIGITS * agreed.rounding_distance:
            return f"{sentence}: these pairs leave some joints open; add pairs in which all joints turn far"
        return sentence

    def _terms_tried(self) -> str:
        if self.terms is None:
            return "joint terms were not tried"
        words, left = self.terms
        if not words:
            return "gravity, couplings, gears and other joint terms were tried, and none halves this error"
        if left.to_the_digits:
            return f"with {words} it agrees to the digits; a URDF has no place for such terms"
        return f"with {words}, {_mm(left.left_out)} are left; a URDF has no place for such terms"

    def report(self) -> str:
        """Return the result as text."""
        before = self.candidate.aligned
        lines = [
            f"{count_noun(len(self.pairs), 'pair')} of {self.pairs.path}: {self.candidate.reading.words()}",
            *(f"note: {remark}" for remark in self.remarks),
            *self.places,
            f"stock model: {_mm(before.rms_distance)} off (RMS, base and tool placed as well as possible)",
            *(f"{row} is of another program, tool or base: {_mm(away)} off; left out" for row, away in self.left_out),
            f"{self.grade}: {self.conclusion}",
        ]
        return plain_text([line[0].upper() + line[1:] for line in lines], _WIDTH, wrap=True).rstrip()

    def to_dict(self) -> dict[str, Any]:
        """Return the result for `--json` and match.json; lengths in mm, angles in mrad."""
        agreed = self.agreement
        numbers = {
            "rms": millimetres(agreed.rms),
            "left_out_in_turn": millimetres(agreed.left_out),
            "digits_allow": millimetres(agreed.rounding_distance),
            "claim": millimetres(agreed.claim) if agreed.to_the_digits else None,
            "claim_angle": in_unit(agreed.turn_claim, "mrad") if agreed.to_the_digits else None,
        }
        return as_data(
            {
                "grade": self.grade,
                "conclusion": self.conclusion,
                "pairs": len(self.pairs),
                "reading": self.candidate.reading.words(),
                "remarks": self.remarks,
                "places": self.places,
                "stock_model": millimetres(self.candidate.aligned.rms_distance),
                "other_program": [row for row, _ in self.left_out],
                **numbers,
            }
        )

    def save(self, folder: Path | str, *, force: bool = False) -> list[str]:
        """Write the result folder of the fit, and the robot in formats for controllers and ROS.

        Args:
            folder: Folder to write.
            force: Whether to replace files that this program did not write.
        """
        save(self.fit, folder, force=force or (self.grade != "FAIL"))
        files = {Path(folder) / "match.json": json_file(self.to_dict())}
        if self.grade != "FAIL" or force:
            for name, file in FILES.items():
                each = formats().get(name)
                if each is not None and each.write is not None and each.fits(self.fit.robot):
                    content = each.write(robot_for(self.fit.robot, name, force=True), [self.conclusion]).content
                    files[Path(folder) / file] = content
        write_files(files, force=force)
        return sorted(path.name for path in files) + ["calibrated.urdf"] * (Path(folder) / "calibrated.urdf").exists()


def _mm(length: float) -> str:
    return quantity_text(length, "mm", ".2g")

"""Report on a compensated program: the error of the tool, without and with the correction.

The same for tables, G-code, controllers' programs and tables of corrections.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.commands.common import Output, failure_lines
from calib.core.robots.robot import Robot
from calib.core.rows.known_robot import KnownRobot
from calib.programs.languages.straight_moves import CompensatedMoves
from calib.programs.reaching.compensation import Compensation

COUNTED = "expected errors include measurement noise, the priors, and what the model leaves out"
"""What an expected error counts."""
Figures = Mapping[str, Mapping[str, float]]
"""Summaries by their name with the unit."""


def frame_sentences(frame: str) -> str:
    """Say where and how errors count, in two sentences.

    Args:
        frame: Its frame, in words.
    """
    return f"Errors are {frame}.\n{COUNTED[0].upper()}{COUNTED[1:]}."


def no_correction_sentence(result: str) -> str:
    """Say why nothing was corrected.

    Args:
        result: Folder of the calibration.
    """
    return f"the verdict of {result} is that nothing is to be corrected"


def summary(values: FloatArray) -> dict[str, float]:
    """Return root mean square and largest of errors (n,)."""
    return {"rms": float(np.sqrt(np.mean(values**2))), "max": float(np.max(values))}


def expected_error_sentence(
    subject: str, expected: Mapping[str, float], unit: str, before: Mapping[str, float] | None = None
) -> str:
    """Say how large an error is expected to be, with the correction and without.

    Args:
        subject: The thing that it is about, such as `The tool`.
        expected: Its `summary`.
        unit: Unit of this.
        before: `summary` of the errors without the correction, with the same uncertainty; None: nothing is corrected.
    """
    now = (
        f"{subject} is expected to be off by {expected['rms']:.4f} {unit} (RMS), {expected['max']:.4f} {unit} at worst"
    )
    if before is None:
        return now
    return f"{now}; without the correction by {math.hypot(before['rms'], expected['rms']):.4f} {unit} (RMS)"


def figures_of(compensation: Compensation) -> dict[str, dict[str, float]]:
    """Return root mean square and largest error of all rows, before and after."""
    return {
        f"{name}_{unit}": summary(values[compensation.ok])
        for (name, unit), values in compensation.figures().items()
        if name.startswith(("before", "expected"))
    }


@dataclass(frozen=True)
class Job:
    """A program to compensate.

    Attributes:
        nominal: The robot as it is described.
        robot_knowledge: The calibrated robot.
        program: File of the program.
        result: Folder of the calibration.
        out: File to write.
        output: Stream to print to.
    """

    nominal: Robot
    robot_knowledge: KnownRobot
    program: str
    result: str
    out: str
    output: Output

    def comments(self, *lines: str) -> tuple[str, ...]:
        """Return comments of the file, with remarks on a calibration that failed."""
        return (*lines, *failure_lines(self.output, self.result, self.out))

    def report(
        self,
        compensated: Compensation | CompensatedMoves,
        figures: Figures,
        content: Mapping[str, object],
        what: tuple[str, str, str],
        more: Sequence[str] = (),
        subjects: tuple[str, str] = ("The tool", "Its orientation"),
    ) -> None:
        """Print the report.

        Args:
            compensated: The thing that was compensated.
            figures: `before_mm`, `expected_mm`, the same of angles where they count, and others for --json.
            content: Further content of --json.
            what: Parts of the program; what was done with them; what was done where nothing is to be corrected.
            more: Further sentences.
            subjects: The things whose length, and whose angle, is off.
        """
        kept = compensated.nothing_to_correct
        common = {"frame": compensated.frame, "counted": COUNTED, "nothing_to_correct": kept}
        self.output.json({**content, **common, **figures})
        parts, done, left = what
        line = f"{parts} {left}: {no_correction_sentence(self.result)}; " if kept else f"{parts} {done}, "
        lines = [f"{line}written to {self.out}"]
        for subject, ending, unit in zip(subjects, ("_mm", "_angle_mrad"), ("mm", "mrad"), strict=True):
            if f"expected{ending}" in figures:
                before = None if kept else figures[f"before{ending}"]
                lines.append(expected_error_sentence(subject, figures[f"expected{ending}"], unit, before))
        self.output.say("\n".join([*lines, *more, frame_sentences(compensated.frame)]))

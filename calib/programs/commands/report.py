"""Report on a compensated program: the error of the tool, without and with the correction.

It serves tables, G-code, controllers' programs and tables of corrections.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.contributions import names_of
from calib.core.commands.common import Output, failure_lines
from calib.core.data.measurement_columns import joint_columns
from calib.core.robots.robot import Robot
from calib.core.rows.frames import KnownRobot
from calib.programs.reaching.compensation import Compensation
from calib.programs.reaching.expected_errors import FramedErrors

Figures = Mapping[str, Mapping[str, float]]
"""Summaries (`rms` and `max`) by name with unit, such as `before_mm`."""


def frame_words(errors: FramedErrors) -> str:
    """Return the frame in which errors count, and their contributions."""
    return f"errors are {errors.frame}; expected errors count {errors.counted}"


def frame_sentences(errors: FramedErrors) -> str:
    """Return `frame_words` as two sentences."""
    return f"Errors are {errors.frame}.\nExpected errors count {errors.counted}."


def no_correction_sentence(result: str) -> str:
    """Return the reason why the program was left unchanged; `result` is the folder of the calibration."""
    return f"the verdict of {result} is that nothing is to be corrected"


def summary(values: FloatArray) -> dict[str, float]:
    """Return root mean square and largest of errors (n,)."""
    return {"rms": float(np.sqrt(np.mean(values**2))), "max": float(np.max(values))}


def expected_error_sentence(
    subject: str, expected: Mapping[str, float], unit: str, before: Mapping[str, float] | None = None
) -> str:
    """Return a sentence on the expected error with the correction and, unless `before` is None, without it.

    `expected` and `before` are `summary` of the errors with and without the correction, in `unit`.
    """
    now = (
        f"{subject} is expected to be off by {expected['rms']:.4f} {unit} (RMS), {expected['max']:.4f} {unit} at worst"
    )
    if before is None:
        return now
    return f"{now}; without the correction by {math.hypot(before['rms'], expected['rms']):.4f} {unit} (RMS)"


def rows_of(
    robot: Robot,
    names: Sequence[str],
    q: FloatArray,
    ok: BoolArray,
    states: Mapping[str, Sequence[object]],
    errors: Mapping[tuple[str, str], FloatArray],
) -> list[dict[str, object]]:
    """Return an entry of --json for each row: its states, joints q (n, n_actuated) [m or rad] where `ok`, and errors.

    Joints are null where the mask `ok` (n,) is not set.
    """
    joints = joint_columns(robot, q)
    return [
        {
            "pose": name,
            **{key: values[k] for key, values in states.items()},
            "joints": {joint: float(values[k]) for joint, values in joints.items()} if ok[k] else None,
            **{f"{error}_{unit}": float(values[k]) for (error, unit), values in errors.items()},
        }
        for k, name in enumerate(names)
    ]


def figures_of(compensation: Compensation) -> dict[str, dict[str, float]]:
    """Return the `summary` of all compensated rows, for errors before and after."""
    return {
        f"{name}_{unit}": summary(values[compensation.ok])
        for (name, unit), values in compensation.figures().items()
        if name.startswith(("before", "expected"))
    }


@dataclass(frozen=True)
class Job:
    """A program to compensate, with the calibration to use and the file to write.

    Attributes:
        nominal: The robot as described.
        robot_knowledge: The calibrated robot.
        program, result, out: Paths of the program, of the calibration's folder, and of the file to write.
    """

    nominal: Robot
    robot_knowledge: KnownRobot
    program: str
    result: str
    out: str
    output: Output

    def comments(self, *lines: str) -> tuple[str, ...]:
        """Return comments for the written file; a failed calibration adds its remarks."""
        return (*lines, *failure_lines(self.output, self.result, self.out))

    def report(
        self,
        compensated: FramedErrors,
        figures: Figures,
        content: Mapping[str, object],
        what: tuple[str, str, str],
        more: Sequence[str] = (),
        subjects: tuple[str, str] = ("The tool", "Its orientation"),
    ) -> None:
        """Print the report, as text and as --json.

        Args:
            compensated: The compensated rows, moves or targets.
            figures: `before_mm` and `expected_mm`; `before_angle_mrad` and `expected_angle_mrad` where orientation
                counts; further figures for --json.
            content: Further content of --json.
            what: Three parts of a sentence: the subject, its predicate if corrected, its predicate if unchanged.
            more: Further sentences.
            subjects: Subjects of the sentences on the error of length and of angle.
        """
        kept = compensated.nothing_to_correct
        common = {"frame": compensated.frame, "contains": names_of(compensated.contains), "nothing_to_correct": kept}
        self.output.json({**content, **common, **figures})
        parts, done, left = what
        line = f"{parts} {left}: {no_correction_sentence(self.result)}; " if kept else f"{parts} {done}, "
        lines = [f"{line}written to {self.out}"]
        for subject, ending, unit in zip(subjects, ("_mm", "_angle_mrad"), ("mm", "mrad"), strict=True):
            if f"expected{ending}" in figures:
                before = None if kept else figures[f"before{ending}"]
                lines.append(expected_error_sentence(subject, figures[f"expected{ending}"], unit, before))
        self.output.say("\n".join([*lines, *more, frame_sentences(compensated)]))

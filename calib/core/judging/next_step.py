"""The next step after a fit, as a sentence and a command to type: for the terminal, `result.json` and the viewer."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from calib.core.base.units import millimetres
from calib.core.fitting.fitted import Fit
from calib.core.fitting.terms.term_sizes import has_poses_for_terms
from calib.core.judging.reasons import Answer
from calib.core.judging.rules_model import why_no_origins
from calib.core.judging.verdict import judge
from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.parametrisation import result_use
from calib.core.robots.robot_files import lost_by

_OPTIONS: dict[Answer, tuple[str, ...]] = {
    Answer.LEAVE_OUT: ("fit again without the outliers", "--exclude-outliers"),
    Answer.ADD_TERMS: ("fit again with joint terms that explain the errors", "--terms", "auto"),
    Answer.TRY_STARTS: ("fit again from several starting points", "--starts", "5"),
    Answer.HOLD_OUT: ("test the result on poses of the file that it is fitted to", "--validate", "0.25"),
    Answer.STATE_NOISE: ("state a smaller noise, or leave out what was read twice, and fit again",),
}
"""Aim and options of the next `calib fit`, for each answer that needs another fit."""
ROBOT, DATA, FOLDER, AGAIN = "ROBOT", "DATA", "DIR", "DIR-2"
"""Placeholders in a command for the files of a user: robot, measurements, result folder, folder of the next result."""


@dataclass(frozen=True)
class NextStep:
    """The next step that the user is advised to take.

    Attributes:
        aim: Its purpose, in words that begin with a verb.
        command: The command to type, or words; `ROBOT`, `DATA` and `DIR` stand for files.
        dropped_options: Options of the fit to omit.
    """

    aim: str
    command: str
    dropped_options: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.aim}: {self.command}"

    @property
    def needs_folder(self) -> bool:
        """Whether the step reads the result folder, and does not write it."""
        return FOLDER in self.aim or FOLDER in self.command.removesuffix(f"--out {FOLDER}").split()

    def with_file_names(
        self, robot: str, data: Sequence[str], folder: str, options: Mapping[str, Sequence[str]]
    ) -> str:
        """Return the sentence with the user's files in place of `ROBOT`, `DATA` and `DIR`.

        Args:
            options: The user's options for this kind of command, with their values, by name.
        """
        files = {ROBOT: shlex.quote(robot), DATA: shlex.join(data), FOLDER: shlex.quote(folder)}
        files[AGAIN] = shlex.quote(f"{folder}-2")
        words = shlex.split(self.command)
        more = [
            word
            for name, values in options.items()
            if name not in (*words, *self.dropped_options)
            for word in (name, *values)
        ]
        end = words.index("--out") if "--out" in words else len(words)
        replaced = (*words[:end], *more, *words[end:])
        return (
            f"{self.aim.replace(FOLDER, folder)}: {' '.join(files.get(word, shlex.quote(word)) for word in replaced)}"
        )


def aim_of(sentence: str) -> str:
    """Return the sentence of a `NextStep` without its command, whose placeholders nobody can type."""
    return sentence.partition(": ")[0].replace(f"{FOLDER}/", "")


def next_step(fit: Fit) -> NextStep:
    """Return the answer to the first reason of the verdict, or a test or use of the result."""
    verdict, done = judge(fit), _tried_answers(fit)
    answers = [reason.answer for reason in verdict.reasons if reason.grade != "PASS"]
    open_answers = [answer for answer in answers if answer is not Answer.LOOK and answer not in done]
    if Answer.CORRECT in open_answers:  # other findings come from the mistake
        return _repeat_fit(fit, "correct the data or the description as the reasons say, and fit again")
    first = Answer.LEAVE_OUT if Answer.LEAVE_OUT in open_answers else next(iter(open_answers), None)
    too_few = first is Answer.ADD_TERMS and not has_poses_for_terms(fit.identification.data)
    if too_few or (first is Answer.TRY_STARTS and fit.convergence.receding_parameters):  # from every start
        first = Answer.OTHER_POSES
    if first in _OPTIONS:  # outliers come first: their effects look like noise, and like joint terms
        return _repeat_fit(fit, *_OPTIONS[first], same_noise=first is not Answer.STATE_NOISE)
    if first is Answer.OTHER_POSES:
        return NextStep("see what these poses do not determine, and measure others", f"calib check {ROBOT} {DATA}")
    if verdict.grade != "FAIL" and fit.validation is None and fit.folds is None:
        aim = "test the result on poses that the fit does not use"
        return _repeat_fit(fit, aim, "--validate", "0.25", folder=FOLDER)
    if answers:
        return NextStep("look at the largest errors", f"calib view {ROBOT} --result {FOLDER}")
    return _use(fit)


def _tried_answers(fit: Fit) -> set[Answer]:
    by_auto = fit.terms is not None and fit.terms.automatic
    tried = {Answer.LEAVE_OUT: fit.with_all is not None, Answer.ADD_TERMS: by_auto, Answer.TRY_STARTS: bool(fit.starts)}
    return {answer for answer, was in tried.items() if was}


def _repeat_fit(fit: Fit, aim: str, *words: str, folder: str = AGAIN, same_noise: bool = True) -> NextStep:
    """Return a fit with the known options of this fit, and one more option."""
    options = {} if fit.sigma_given is None or not same_noise else {"--sigma-mm": f"{millimetres(fit.sigma_given):g}"}
    options |= {} if fit.loss == "none" else {"--loss": fit.loss}
    options |= {} if fit.terms is None else {"--terms": fit.terms.requested}
    options |= {} if fit.starts is None else {"--starts": str(fit.starts.total)}
    options |= {} if fit.with_all is None else {"--exclude-outliers": ""}
    options |= fit.requested_options.options() | ({"--seed": str(fit.seed)} if fit.seed else {})
    options |= {words[0]: " ".join(words[1:])} if words else {}
    options_text = (shlex.quote(word) for option in options.items() for word in option if word)
    without = () if same_noise else ("--sigma-mm",)
    return NextStep(aim, " ".join(("calib fit", ROBOT, DATA, *options_text, "--out", folder)), without)


def _use(fit: Fit) -> NextStep:
    """The next step for a result without objections: it depends on the robot, and on what its files hold."""
    verdict = judge(fit)
    if verdict.nothing_to_correct:
        remarks, data = {reason.answer for reason in verdict.reasons} - _tried_answers(fit), fit.identification.data
        if Answer.ADD_TERMS in remarks and has_poses_for_terms(data):  # errors are left that no parameter describes
            return _repeat_fit(fit, *_OPTIONS[Answer.ADD_TERMS])
        return NextStep("keep the nominal robot, and test it again later", f"calib verify {FOLDER} measured.csv")
    if own := result_use(fit.nominal.description):
        return NextStep(own.aim, own.command)
    program = f"calib compensate {FOLDER} program.csv --out compensated.csv"
    if why_no_origins(fit):
        return NextStep("correct a program by the whole model", program)
    if not lost_by(fit.robot, Holds.ORIGINS):
        return NextStep(f"use {FOLDER}/calibrated.urdf, or correct a program by it", program)
    origins, whole = (fit.robot.files[holds].accuracy for holds in (Holds.ORIGINS, Holds.EVERYTHING))
    both = f"{whole.in_unit(whole.rms)} with them, {origins.in_unit(origins.rms)} without, RMS at {whole.pose_words}"
    if fit.terms is not None and whole.rms > origins.rms:
        return _repeat_fit(fit, f"leave out the joint terms: they make it no better ({both})", "--terms", "none")
    return NextStep(f"correct a program by the whole model, whose joint terms a URDF cannot hold ({both})", program)

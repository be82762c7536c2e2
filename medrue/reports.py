"""Output folders of `medrue study`, `medrue experiment` and `medrue touch`."""

from __future__ import annotations

import numpy as np

from calib.core.base.units import quantity_text
from calib.core.base.words import count_noun
from calib.core.data.measurement_files import format_measurements
from medrue.both_sides import RAIL, WAYS, BothSides
from medrue.both_sides_tables import NOISE, mean_x
from medrue.experiment import Experiment
from medrue.experiment_tables import cause_rms, experiment_findings, experiment_tables
from medrue.pages import NamedFigure, Report
from medrue.plots import (
    axis_figure,
    before_after_figure,
    cause_figure,
    exchange_figure,
    pose_count_figure,
    spread_figure,
    workspace_figure,
)
from medrue.study import COUNT, PaperStudy
from medrue.study_tables import study_findings, study_tables
from medrue.touch import WAYS as TOUCH_WAYS
from medrue.touch import TouchStudy
from medrue.touch_tables import touch_findings, touch_tables
from medrue.tracker import REPEATS, SIGMA
from medrue.workspace import target_workspace


def study_report(study: PaperStudy) -> Report:
    """Return the report of the simulation study."""
    return Report(
        "The paper's simulation study: Tables I and II, Figures 4 and 5",
        "Measurements are computed from Table I's actual parameters by the closed form, plus normal noise of 40 µm on"
        " each axis. The 420 poses are this project's; the paper's are not public, so Table II can be compared in kind,"
        " not in numbers.",
        study_findings(study),
        study_tables(study),
        (_exchange(study), _study_errors(study), _spread_figure(study)),
        study.seed,
    )


def _exchange(study: PaperStudy) -> NamedFigure:
    selection = study.selections["O1"]
    bound = "" if selection.bound is None else " The dashed line is a proven bound."
    return NamedFigure(
        "figure4",
        "Figure 4: O1 over the iterations",
        f"Every point is the index after one exchange.{bound}",
        exchange_figure(selection),
    )


def _study_errors(study: PaperStudy) -> NamedFigure:
    others = study.sets[0].validation_indices(len(study.joints))
    before = np.linalg.norm(study.robot.positions(study.joints)[others, 0] - study.truth[others], axis=1)
    return NamedFigure(
        "figure5",
        "Figure 5: position errors before and after calibration in simulation",
        f"Distance from the true position at the {len(others)} validation poses, {COUNT} poses of O1, first draw"
        " of the noise; both panels have the same axes.",
        before_after_figure(
            before, study.outcome.distances[0, 0, others], "Simulation: position errors at the validation poses"
        ),
    )


def _spread_figure(study: PaperStudy) -> NamedFigure:
    errors = study.validation_errors(study.outcome)[:, :, 3]
    draws = count_noun(len(errors), "draw")
    return NamedFigure(
        "errors_over_draws",
        "Errors over the draws of the noise",
        "Boxes: quartiles of the root-mean-square error of each draw; whiskers: up to 1.5 times the box; every set of"
        " poses sees the same noise. The Cramér-Rao bound is on the mean square over the draws: compare the open"
        " diamonds with the dots beside them, not with the boxes. By chance a dot may lie a little below.",
        spread_figure(study.names, errors, study.floors, f"Simulation: {draws} of the noise"),
    )


def experiment_report(experiment: Experiment) -> Report:
    """Return the report of the simulated experiment."""
    return Report(
        "The paper's experiment on a simulated robot: Tables III to V, Figures 3, 7 and 8",
        "The measurements of the paper are not public. The robot is simulated. It has the parameters that the paper"
        " identified (Table III), and causes to which the paper attributes the remaining error:"
        f" {experiment.imperfections}. A simulated tracker (40 µm, five readings averaged) stands in a frame of its own"
        " and finds the world from three nests. A second measurement of the same robots approaches every pose from both"
        f" sides; its rail also has {RAIL}. From it an extended model is identified:"
        " all six components of every origin, with priors, and the lead, the turns and the backlash of the screw. The"
        " truth is that model with other values, and with wear and bend, which the model does not have.",
        experiment_findings(experiment),
        experiment_tables(experiment),
        (_workspace(), *_experiment_errors(experiment), _causes(experiment), _pose_count(experiment.both_sides)),
        experiment.seed,
        {"both_sides.csv": _measurement_file(experiment)},
    )


def _measurement_file(experiment: Experiment) -> str:
    """The first robot's measurement from both sides, for `calib fit` and the extended model."""
    comments = (
        "simulated measurements of MedRUE; no real robot was measured",
        f"all poses from both sides: approach_q1 is the direction in which the rail came; seed {experiment.seed}",
        f"tracker noise {quantity_text(SIGMA, 'mm', 'g')} on each axis, {count_noun(REPEATS, 'reading')} averaged",
    )
    both_sides = experiment.both_sides
    return format_measurements(both_sides.extended, both_sides.first_measurements(), comments)


def _workspace() -> NamedFigure:
    return NamedFigure(
        "figure3",
        "Figure 3: the target workspace",
        "The paper's figure places the half cylinder, its text does not; this placement is the project's.",
        workspace_figure(target_workspace()),
    )


def _experiment_errors(experiment: Experiment) -> tuple[NamedFigure, ...]:
    before, after = experiment.validation(experiment.draws[0], "O1")
    return (
        NamedFigure(
            "figure7",
            "Figure 7: position errors before and after calibration in the simulated experiment",
            f"Distance from the measured position at the {len(before)} validation poses, poses of O1, first draw; both"
            " panels have the same axes.",
            before_after_figure(
                np.linalg.norm(before, axis=1),
                np.linalg.norm(after, axis=1),
                "Simulated experiment: position errors at the validation poses",
            ),
        ),
        NamedFigure(
            "figure8",
            "Figure 8: errors along each axis in the simulated experiment",
            "Magnitudes of the components at the same poses; both panels have the same axes.",
            axis_figure(before, after, "Simulated experiment: errors along each axis"),
        ),
    )


def _causes(experiment: Experiment) -> NamedFigure:
    return NamedFigure(
        "causes",
        "What remains, by cause",
        "Root mean square along each axis after calibration, with one cause at a time and with all, over the same"
        f" {count_noun(len(experiment.draws), 'draw')}.",
        cause_figure(cause_rms(experiment)),
    )


def touch_report(study: TouchStudy) -> Report:
    """Return the report of the calibrations without a tracker."""
    return Report(
        "MedRUE without a tracker: touched sockets, and encoders on passive joints",
        "No robot was measured. Either the ball at the tip of the probe touches sockets of an artefact, and only the"
        " joints are read; or all seven passive joints have encoders; or the tracker of the simulation study measures."
        " Joint values and readings come from the closed form, with the actual parameters and normal noise of"
        f" 40 µm. Every method measures {COUNT} poses that it chose by the smallest error predicted in the target"
        " workspace.",
        touch_findings(study),
        touch_tables(study),
        (_touch_errors(study),),
        study.seed,
    )


def _touch_errors(study: TouchStudy) -> NamedFigure:
    before, after = (study.noise[0, study.names.index(name), TOUCH_WAYS.index("world")] for name in ("before", "touch"))
    return NamedFigure(
        "errors",
        "Position errors before and after calibration by touch",
        f"Distance from the true position at all {len(before)} poses of the target workspace, first draw of the noise;"
        " both panels have the same axes.",
        before_after_figure(before, after, "Simulation: position errors in the target workspace, touched sockets"),
    )


def _pose_count(both_sides: BothSides) -> NamedFigure:
    draws = count_noun(len(both_sides.draws), "draw")
    return NamedFigure(
        "pose_count",
        "How many poses the extended model needs",
        f"Mean over {draws} at all other poses, approached from both sides. Either side: each pose is visited once,"
        " from a side that chance decides; one side: always in the positive direction.",
        pose_count_figure(
            tuple(len(pose_set.chosen) for pose_set in both_sides.sets[1:]),
            {way.name: mean_x(both_sides, way)[:, 1:].mean(axis=0) for way in WAYS},
            float(NOISE * np.sqrt(2 / np.pi)),
        ),
    )

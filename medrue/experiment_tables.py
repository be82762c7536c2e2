"""Tables of the simulated experiment with the paper's, and their findings in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.units import millimetres, quantity_text
from calib.core.base.words import count_noun
from medrue.both_sides_tables import (
    BOTH_SIDES_NOTE,
    both_sides_error_columns,
    both_sides_findings,
    both_sides_tables,
    component_columns,
)
from medrue.error_before import base_placed
from medrue.experiment import Experiment, ExperimentDraw
from medrue.imperfections import Imperfections
from medrue.paper_tables import error_table, table3
from medrue.ranking import Ranking, rank, ranking_table, standard_error
from medrue.result_tables import ResultTable, TableColumn
from medrue.study import STATISTICS, summary
from medrue.study_tables import error_columns, parameter_columns, printed_errors
from medrue.tracker import OUTLIER_PROBABILITY, REPEATS, SIGMA


def experiment_tables(experiment: Experiment) -> tuple[ResultTable, ...]:
    """Return all tables of the experiment."""
    return (
        parameter_table(experiment),
        index_table(experiment),
        ranking_table({"mean error": experiment_ranking(experiment)}),
        axis_table(experiment),
        cause_table(experiment),
        *both_sides_tables(experiment.both_sides),
    )


def parameter_table(experiment: Experiment) -> ResultTable:
    """Table III: the parameters that the 84 poses of O1 identify."""
    draw, free = experiment.draws[0], experiment.robot.is_free
    columns = {
        "nominal": table3().nominal,
        "actual (paper: identified)": table3().identified,
        "identified": draw.values[0],
        "std": np.where(free, draw.std[0], np.nan),
        "identified - actual": np.where(free, draw.values[0] - table3().identified, np.nan),
    }
    return ResultTable(
        "table3",
        "Table III: parameters identified in the simulated experiment from the 84 poses of O1",
        parameter_columns(experiment.robot, columns),
        (
            f"simulated; seed {experiment.seed}; the simulated robot has the parameters that the paper identified",
            _share_beyond_std(draw, free),
        ),
    )


def _share_beyond_std(draw: ExperimentDraw, free: BoolArray) -> str:
    """Rate of true values outside the stated intervals."""
    off = np.abs(draw.values[0] - table3().identified)[free] > 2 * draw.std[0][free]
    return (
        f"{int(off.sum())} of {len(off)} identified parameters more than two std from actual; by chance one in twenty"
    )


def index_table(experiment: Experiment) -> ResultTable:
    """Table IV: position errors by the index that chose the poses."""
    after = np.array([[_summary(experiment, draw, name)[1] for name in experiment.names] for draw in experiment.draws])
    before = _summary(experiment, experiment.draws[0], "O1")[0]
    printed, draws = error_table(4), count_noun(len(after), "draw")
    rows: list[tuple[str, float, FloatArray]] = []
    for k, statistic in enumerate(STATISTICS):
        rows += [
            (f"{statistic}, single draw", float(before[k]), after[0, :, k]),
            (f"{statistic}, mean over {draws}", np.nan, after[:, :, k].mean(axis=0)),
            (f"{statistic}, standard error over {draws}", np.nan, standard_error(after[:, :, k])),
            (f"{statistic}, paper", printed["before"][statistic], printed_errors(4, statistic, experiment.names)),
        ]
    return ResultTable(
        "table4",
        "Table IV: position errors in the simulated experiment, by the index that chose the 84 poses",
        (*error_columns(rows, experiment.names), *both_sides_error_columns(experiment.both_sides)),
        (
            f"simulated; distance from the measured position at the 336 other poses; seed {experiment.seed}",
            "before: the nominal robot at the validation poses of O1; the first draw is the single one",
            "a draw has other tilts of the axes, another order of the poses and other noise",
            BOTH_SIDES_NOTE,
        ),
    )


def experiment_ranking(experiment: Experiment) -> Ranking:
    """Ranking of the choices of poses by their mean error."""
    errors = [[_summary(experiment, draw, name)[1][0] for name in experiment.names] for draw in experiment.draws]
    return rank(experiment.names, np.array(errors))


def axis_table(experiment: Experiment) -> ResultTable:
    """Table V: position errors along each axis, for the poses of O1."""
    printed = error_table(5)
    columns = [
        TableColumn(
            "error [mm]", [f"{statistic}{who}" for statistic in STATISTICS for who in (", simulated", ", paper")]
        )
    ]
    for when, errors in zip(("before", "after"), experiment.validation(experiment.draws[0], "O1"), strict=True):
        for axis, values in zip("xyz", np.abs(errors.T), strict=True):
            ours = dict(zip(STATISTICS, millimetres(summary(values)), strict=False))
            cells = [cell for key in STATISTICS for cell in (float(ours[key]), printed[f"{when}_{axis}"][key])]
            columns.append(TableColumn(f"{when} {axis}", cells))
    columns += component_columns(experiment.both_sides)
    return ResultTable(
        "table5",
        "Table V: position errors along each axis in the simulated experiment, poses of O1",
        tuple(columns),
        (
            f"simulated; magnitudes of the components at the 336 validation poses; seed {experiment.seed}",
            BOTH_SIDES_NOTE,
        ),
    )


def cause_table(experiment: Experiment) -> ResultTable:
    """Error that each cause alone leaves after calibration."""
    rows = cause_rms(experiment)
    sizes = {
        "tracker noise alone": f"{quantity_text(SIGMA, 'um', '.0f')}, {count_noun(REPEATS, 'reading')} averaged",
        **experiment.imperfections.sizes,
    }
    columns = [TableColumn("cause", rows), TableColumn("size", [sizes.get(name, "") for name in rows])]
    for axis, values in zip(("x", "y", "z", "distance"), zip(*rows.values(), strict=True), strict=True):
        columns.append(TableColumn(f"RMS {axis} [mm]", values, 4))
    notes = [
        "simulated; each cause with the tracker's noise, calibrated from the poses of O1, at the 336 others; root mean"
        f" square over the same {count_noun(len(experiment.draws), 'draw')} in every row"
    ]
    if experiment.imperfections == Imperfections():
        notes.append(
            "the paper gives the lead error; the other sizes are chosen so that the error that remains is the paper's"
        )
    return ResultTable("causes", "What remains after calibration, by cause", tuple(columns), tuple(notes))


def cause_rms(experiment: Experiment) -> dict[str, FloatArray]:
    """Root mean square of x, y, z and distance after calibration from O1's poses, by cause, (4,) [mm]."""
    others = experiment.sets[0].validation_indices(len(experiment.joints))

    def rms(draws: Sequence[ExperimentDraw]) -> FloatArray:
        squares = np.mean([millimetres(draw.after[0, others]) ** 2 for draw in draws], axis=(0, 1))
        return np.sqrt(np.append(squares, squares.sum()))

    return {name: rms(draws) for name, draws in {**experiment.causes, "all together": experiment.draws}.items()}


def experiment_findings(experiment: Experiment) -> tuple[str, ...]:
    """Say in words what the tables show."""
    ranking, printed = experiment_ranking(experiment), error_table(4)
    paper = [values["mean"] for name, values in printed.items() if name != "before"]
    before, after = _summary(experiment, experiment.draws[0], "O1")
    return (
        f"Calibration from O1's poses takes the mean error from {before[0]:.3f} to {after[0]:.3f} mm; in the paper from"
        f" {printed['before']['mean']:.3f} to {printed['O1']['mean']:.3f} mm.",
        _error_before_finding(experiment),
        _axis_finding(experiment),
        f"Mean error over {count_noun(ranking.n_draws, 'draw')}, least first: {ranking}. The largest is"
        f" {100 * (ranking.means[-1] / ranking.means[0] - 1):.0f} % above the least; in the paper"
        f" {100 * (max(paper) / min(paper) - 1):.0f} %, from one experiment.",
        _measuring_finding(experiment),
        *both_sides_findings(experiment.both_sides),
    )


def _error_before_finding(experiment: Experiment) -> str:
    """Sentence on whether the choice of poses can explain the error before."""
    draw, printed = experiment.draws[0], error_table(4)["before"]["mean"]
    distances = millimetres(np.linalg.norm(draw.before, axis=1))
    nominal = experiment.robot.positions(experiment.joints)[:, 0]
    placed = millimetres(np.linalg.norm(base_placed(nominal, nominal - draw.before), axis=1)).mean()
    below = int(np.sum(distances <= printed))
    verdict = (
        "all our poses are above the paper's mean, so the choice of validation poses does not explain it"
        if below == 0
        else f"{count_noun(below, 'pose')} of ours {'is' if below == 1 else 'are'} not above the paper's mean"
    )
    return (
        f"Before calibration the error lies between {distances.min():.2f} and {distances.max():.2f} mm over all"
        f" {len(distances)} poses, {distances.mean():.2f} mm on average, {placed:.2f} mm with the base placed by a best"
        f" fit: {verdict}."
    )


def _axis_finding(experiment: Experiment) -> str:
    """Which axis the remaining error is along."""
    squares = cause_rms(experiment)["all together"][:3] ** 2
    printed = error_table(5)
    paper = np.array([printed[f"after_{axis}"]["mean"] ** 2 + printed[f"after_{axis}"]["std"] ** 2 for axis in "xyz"])
    largest = int(np.argmax(squares))
    mostly = f" is mostly along {'xyz'[largest]}:" if squares[largest] > squares.sum() / 2 else ":"
    shares = [
        ", ".join(f"{a} {100 * v / s.sum():.0f} %" for a, v in zip("xyz", s, strict=True)) for s in (squares, paper)
    ]
    return f"The error after calibration{mostly} {shares[0]} of the mean square; in the paper {shares[1]}."


def _measuring_finding(experiment: Experiment) -> str:
    """How good the simulated measurement was."""
    draw, draws = experiment.draws[0], experiment.draws
    outliers = sum(len(each.nest_outliers) for each in draws)
    return (
        f"Repeats at one pose scatter by {quantity_text(draw.repeatability, 'um', '.1f')} on each axis (repeatability)."
        f" The world frame from three nests is uncertain by up to {quantity_text(draw.frame_sigma, 'um', '.0f')} at the"
        f" tool (one standard deviation). Nests that seem not to fit: {outliers} in {count_noun(len(draws), 'draw')};"
        f" chance alone does that in up to one of {1 / OUTLIER_PROBABILITY:.0f}."
    )


def _summary(experiment: Experiment, draw: ExperimentDraw, name: str) -> tuple[FloatArray, FloatArray]:
    """Mean, max, std and RMS of the distances before and after, at the poses that a set leaves, each (4,) [mm]."""
    before, after = experiment.validation(draw, name)
    return summary(millimetres(np.linalg.norm(before, axis=1))), summary(millimetres(np.linalg.norm(after, axis=1)))

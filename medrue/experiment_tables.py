"""Tables of the simulated experiment beside the paper's, and what they say."""

from __future__ import annotations

import numpy as np

from calib.model.mechanism import FloatArray
from calib.numerics.rigid import OUTLIER_PROBABILITY
from calib.units import PER_SI
from medrue.experiment import REPEATS, SIGMA, Experiment, ExperimentDraw
from medrue.paper_tables import error_table, table1, table3
from medrue.ranking import LEGEND, rank, standard_error
from medrue.result_tables import Cell, Column, ResultTable

STATISTICS = ("mean", "max", "std")


def experiment_tables(experiment: Experiment) -> tuple[ResultTable, ...]:
    """Return all tables of the experiment."""
    return (
        parameter_table(experiment),
        index_table(experiment),
        axis_table(experiment),
        cause_table(experiment),
    )


def parameter_table(experiment: Experiment) -> ResultTable:
    """Table III: the parameters that the 84 poses of O1 identify."""
    parameters = experiment.robot.parameters
    scale = np.array([PER_SI[parameter.dimension][parameter.unit] for parameter in parameters])
    draw, free = experiment.draws[0], experiment.robot.free

    def column(header: str, values: FloatArray) -> Column:
        return Column(header, tuple(None if np.isnan(value) else float(value) for value in values * scale))

    return ResultTable(
        "table3",
        "Table III: parameters identified in the simulated experiment from the 84 poses of O1",
        (
            Column("parameter", tuple(parameter.name for parameter in parameters)),
            Column("unit", tuple(parameter.unit for parameter in parameters)),
            column("nominal", table3().nominal),
            column("actual (paper: identified)", table3().identified),
            column("identified", draw.values[0]),
            column("std", np.where(free, draw.std[0], np.nan)),
            column("identified - actual", np.where(free, draw.values[0] - table3().identified, np.nan)),
            Column("redundant", tuple("yes" if name in table1().redundant else "no" for name in table1().names)),
        ),
        (
            f"simulated; seed {experiment.seed}; the simulated robot has the parameters that the paper identified",
            "identified differs from actual by more than std says where parameters take up part of what the model"
            " leaves out",
        ),
    )


def index_table(experiment: Experiment) -> ResultTable:
    """Table IV: position errors by the index that chose the poses."""
    after = np.array(
        [[_summary(experiment.validation(draw, name)[1]) for name in experiment.names] for draw in experiment.draws]
    )
    before = _summary(experiment.validation(experiment.draws[0], experiment.names[0])[0])
    printed = error_table(4)
    rows: list[tuple[str, Cell, FloatArray]] = []
    for k, statistic in enumerate(STATISTICS):
        paper = [printed[name][statistic] if name in printed else np.nan for name in experiment.names]
        rows += [
            (f"{statistic}, single draw", float(before[k]), after[0, :, k]),
            (f"{statistic}, mean over {len(after)} draws", None, after[:, :, k].mean(axis=0)),
            ("  standard error", None, standard_error(after[:, :, k])),
            (f"{statistic}, paper", printed["before"][statistic], np.array(paper)),
        ]
    columns = [Column("error [mm]", tuple(row[0] for row in rows)), Column("before", tuple(row[1] for row in rows))]
    for s, name in enumerate(experiment.names):
        columns.append(Column(name, tuple(None if np.isnan(row[2][s]) else float(row[2][s]) for row in rows)))
    return ResultTable(
        "table4",
        "Table IV: position errors in the simulated experiment, by the index that chose the 84 poses",
        tuple(columns),
        (
            f"simulated; distance from the measured position at the 336 other poses; seed {experiment.seed}",
            "a draw has other tilts of the axes, another order of the poses and other noise",
        ),
    )


def axis_table(experiment: Experiment) -> ResultTable:
    """Table V: position errors along each axis, for the poses of O1."""
    printed = error_table(5)
    columns = [
        Column(
            "error [mm]", tuple(f"{statistic}{who}" for statistic in STATISTICS for who in (", simulated", ", paper"))
        )
    ]
    for when, errors in zip(("before", "after"), experiment.validation(experiment.draws[0], "O1"), strict=True):
        for axis, values in zip("xyz", np.abs(errors.T) * 1e3, strict=True):
            ours = {"mean": values.mean(), "max": values.max(), "std": values.std(ddof=1)}
            cells = [cell for key in STATISTICS for cell in (float(ours[key]), printed[f"{when}_{axis}"][key])]
            columns.append(Column(f"{when} {axis}", tuple(cells)))
    return ResultTable(
        "table5",
        "Table V: position errors along each axis in the simulated experiment, poses of O1",
        tuple(columns),
        (f"simulated; magnitudes of the components at the 336 validation poses; seed {experiment.seed}",),
    )


def cause_table(experiment: Experiment) -> ResultTable:
    """What each cause alone leaves after calibration."""
    imperfections = experiment.imperfections
    sizes = {
        "tracker noise alone": f"{1e6 * SIGMA:.0f} um, {REPEATS} readings averaged",
        "lead error": f"{imperfections.lead * 0.3 * 1e6:.0f} um per 300 mm",
        "links out of perpendicular": f"{np.degrees(imperfections.tilt):.2f} deg (std of each axis)",
        "backlash of the rail": f"{1e3 * imperfections.backlash:.2f} mm",
    }
    rows = cause_rms(experiment)
    columns = [Column("cause", tuple(rows)), Column("size", tuple(sizes.get(name, "") for name in rows))]
    for k, axis in enumerate(("x", "y", "z", "distance")):
        columns.append(Column(f"rms {axis} [mm]", tuple(float(values[k]) for values in rows.values())))
    return ResultTable(
        "causes",
        "What remains after calibration, by cause",
        tuple(columns),
        (
            "simulated; each cause with the tracker's noise, calibrated from the poses of O1, at the 336 others;"
            f" mean of {len(next(iter(experiment.causes.values())))} draws",
            "the paper gives the lead error; the other sizes are chosen so that as much remains as in the paper",
        ),
    )


def cause_rms(experiment: Experiment) -> dict[str, FloatArray]:
    """Root mean square of x, y, z and distance after calibration, by cause, mean over draws, (4,) [mm]."""
    draws = {**experiment.causes, "all together": experiment.draws}
    return {name: np.mean([_axis_rms(experiment, one) for one in some], axis=0) for name, some in draws.items()}


def experiment_findings(experiment: Experiment) -> tuple[str, ...]:
    """Say in words what the tables show."""
    draw = experiment.draws[0]
    before, after = (_summary(errors) for errors in experiment.validation(draw, "O1"))
    squares = np.mean([_axis_rms(experiment, one)[:3] ** 2 for one in experiment.draws], axis=0)
    paper = error_table(5)
    paper_squares = np.array(
        [paper[f"after_{axis}"]["mean"] ** 2 + paper[f"after_{axis}"]["std"] ** 2 for axis in "xyz"]
    )
    errors = np.array(
        [[_summary(experiment.validation(one, name)[1])[0] for name in experiment.names] for one in experiment.draws]
    )
    printed = [values["mean"] for name, values in error_table(4).items() if name != "before"]
    outliers = sum(len(one.nest_outliers) for one in experiment.draws)
    means = errors.mean(axis=0)
    return (
        f"Calibration from O1's poses takes the mean error from {before[0]:.3f} to {after[0]:.3f} mm; in the paper from"
        f" {error_table(4)['before']['mean']:.3f} to {error_table(4)['O1']['mean']:.3f} mm. The error before is that"
        " of Table III's parameters at our poses; the paper's poses are not public.",
        f"What the paper's model leaves is mostly along x: {100 * squares[0] / squares.sum():.0f} % of the mean square"
        f" error, in the paper {100 * paper_squares[0] / paper_squares.sum():.0f} %.",
        f"Mean error over {len(errors)} draws, best first: {rank(experiment.names, errors)} ({LEGEND}). The worst"
        f" choice is {100 * (means.max() / means.min() - 1):.0f} % above the best; in the paper"
        f" {100 * (max(printed) / min(printed) - 1):.0f} %, from one experiment.",
        f"Repeats at one pose scatter by {1e6 * draw.repeatability:.1f} um on each axis (repeatability). The world"
        f" frame from three nests is uncertain by up to {1e6 * draw.frame_sigma:.0f} um at the tool (one standard"
        f" deviation). Nests that seem not to fit: {outliers} in {len(experiment.draws)} draws; chance alone"
        f" does that in up to one of {1 / OUTLIER_PROBABILITY:.0f}.",
    )


def _summary(errors: FloatArray) -> FloatArray:
    """Mean, max and standard deviation of the distances, (3,) [mm]."""
    distance = 1e3 * np.linalg.norm(errors, axis=1)
    return np.array([distance.mean(), distance.max(), distance.std(ddof=1)])


def _axis_rms(experiment: Experiment, draw: ExperimentDraw) -> FloatArray:
    """Root mean square of x, y, z and distance after calibration from O1's poses, (4,) [mm]."""
    others = experiment.sets[0].others(len(experiment.joints))
    squares = (1e3 * draw.after[0, others]) ** 2
    per_axis = squares.mean(axis=0)
    return np.sqrt(np.append(per_axis, per_axis.sum()))

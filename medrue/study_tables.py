"""Tables of the simulation study with the paper's, and their findings in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.units import in_unit, millimetres, quantity_text
from calib.core.base.words import count_noun
from calib.core.numerics.observability import information
from calib.core.robots.robot import Robot
from medrue.paper_tables import error_table, table1
from medrue.ranking import LEGEND, Ranking, agreement, rank, ranking_table, standard_error
from medrue.result_tables import ResultTable, TableColumn
from medrue.study import COUNT, SIGMA, STATISTICS, PaperStudy


def study_tables(study: PaperStudy) -> tuple[ResultTable, ...]:
    """Return all tables of the study."""
    return (
        parameter_table(study),
        index_table(study),
        ranking_table(_rankings(study.names, millimetres(study.validation_errors(study.outcome)))),
        floor_table(study),
        observability_table(study),
    )


def parameter_table(study: PaperStudy) -> ResultTable:
    """Table I: the parameters that the 84 poses of O1 identify."""
    paper, free = table1(), study.robot.is_free
    std = np.full(len(free), np.nan)
    std[free] = _predicted_std(study)
    columns = {
        "nominal": paper.nominal,
        "actual": paper.actual,
        "identified without noise": study.exact.robot.values,
        "identified with noise": study.single.robot.values,
        "predicted std": std,
        "scatter over draws": np.where(free, study.outcome.values[:, 0].std(axis=0, ddof=1), np.nan),
        "paper: without noise": paper.identified_without_noise,
        "paper: with noise": paper.identified_with_noise,
    }
    return ResultTable(
        "table1",
        "Table I: parameters identified in simulation from the 84 poses of O1",
        parameter_columns(study.robot, columns),
        (
            f"simulated; noise sigma {quantity_text(SIGMA, 'um', '.0f')} on each axis, seed {study.seed}; scatter over"
            f" {count_noun(len(study.outcome.values), 'draw')} of the noise",
            "redundant parameters stay nominal; the nominal joint offsets are zero (the paper's Table I prints others)",
        ),
    )


def parameter_columns(robot: Robot, columns: Mapping[str, FloatArray]) -> tuple[TableColumn, ...]:
    """Return the columns of a table of the paper's parameters, from values (36,) [m, rad] by their headings."""
    parameters, redundant = robot.parameters, table1().redundant
    return (
        TableColumn("parameter", [parameter.name for parameter in parameters]),
        TableColumn("unit", [parameter.unit for parameter in parameters]),
        *(TableColumn(name, values * parameters.per_si) for name, values in columns.items()),
        TableColumn("redundant", ["yes" if parameter.name in redundant else "no" for parameter in parameters]),
    )


def error_columns(
    rows: Sequence[tuple[str, float, FloatArray]], names: tuple[str, ...], digits: int = 3
) -> tuple[TableColumn, ...]:
    """Return the columns of a table of errors.

    Args:
        rows: Of each row its heading, the error before calibration, and those after it, (n_sets,) [mm].
        names: The pose sets.
        digits: Digits of the errors after calibration.
    """
    headings, before, after = zip(*rows, strict=True)
    columns = zip(names, zip(*after, strict=True), strict=True)
    return (
        TableColumn("error [mm]", headings),
        TableColumn("before", before),
        *(TableColumn(name, values, digits) for name, values in columns),
    )


def printed_errors(number: int, statistic: str, names: tuple[str, ...]) -> FloatArray:
    """Return a row of the paper's Table II or IV, NaN where it has no such column, (n_sets,) [mm]."""
    printed = error_table(number)
    return np.array([printed[name][statistic] if name in printed else np.nan for name in names])


def _predicted_std(study: PaperStudy) -> FloatArray:
    """Standard deviations of the free parameters that the stated noise predicts, (n_free,) [m, rad]."""
    return study.exact.unknowns.scales * information(study.exact.rows.jacobian).standard_deviations()


def index_table(study: PaperStudy) -> ResultTable:
    """Table II: position errors of the calibrated robot, by choice of poses."""
    draws = millimetres(study.validation_errors(study.outcome))
    by_actual = millimetres(np.array([study.validation_errors(outcome).mean(axis=0) for outcome in study.by_actual]))
    before = millimetres(study.nominal_errors())
    printed = error_table(2)
    rows: list[tuple[str, float, FloatArray]] = []
    noise, robots = f"{count_noun(len(draws), 'draw')} of noise", count_noun(len(by_actual), "actual robot")
    for k, statistic in enumerate(STATISTICS):
        rows += [
            (f"{statistic}, single draw", float(before[k]), draws[0, :, k]),
            (f"{statistic}, mean over {noise}", np.nan, draws[:, :, k].mean(axis=0)),
            (f"{statistic}, standard error over {noise}", np.nan, standard_error(draws[:, :, k])),
            (f"{statistic}, mean over {robots}", np.nan, by_actual[:, :, k].mean(axis=0)),
            (f"{statistic}, standard error over {robots}", np.nan, standard_error(by_actual[:, :, k])),
            (f"{statistic}, paper", printed["before"][statistic], printed_errors(2, statistic, study.names)),
        ]
    return ResultTable(
        "table2",
        "Table II: position errors in simulation, by the index that chose the 84 poses to identify with",
        error_columns(rows, study.names, digits=4),
        (
            f"simulated; distance from the true position at the {len(study.joints) - COUNT} other poses;"
            f" seed {study.seed}",
            "before: the nominal robot at the validation poses of O1; the first draw is the single one",
            f"actual robots: drawn within +-2 mm and +-1.5 deg, {count_noun(study.size.noise_per_actual, 'draw')} of"
            " noise each",
            "task: smallest predicted error over all 420 poses; the paper does not have it",
        ),
    )


def floor_table(study: PaperStudy) -> ResultTable:
    """The theoretical limit and the results of the draws."""
    squares = millimetres(study.validation_errors(study.outcome)[:, :, 3]) ** 2
    mean_squares, spread = squares.mean(axis=0), standard_error(squares)
    floors = millimetres(study.floors)
    return ResultTable(
        "floor",
        "Root-mean-square error over the validation poses: theory (Cramer-Rao) and draws",
        (
            TableColumn("poses chosen by", study.names),
            TableColumn("theory [mm]", floors, 4),
            TableColumn("draws [mm]", np.sqrt(mean_squares), 4),
            TableColumn("ratio of squares", mean_squares / floors**2),
            TableColumn("its standard error", spread / floors**2),
        ),
        (
            f"simulated; {count_noun(len(squares), 'draw')} of the noise; draws: root of the mean square over all of"
            f" them",
            "a ratio of 1 means that no unbiased estimate can be better",
        ),
    )


def observability_table(study: PaperStudy) -> ResultTable:
    """Indices of every choice of poses."""
    values = [
        study.selections[name].after if name in study.selections else study.selections["O1"].before
        for name in study.names
    ]
    efficiency = [study.selections[name].efficiency if name in study.selections else None for name in study.names]
    columns = [TableColumn("poses chosen by", study.names)]
    for index in ("O1", "O2", "O3", "O4", "O5"):
        best = max(value[index] for value in values)
        columns.append(TableColumn(f"{index} [% of the best]", [100 * value[index] / best for value in values], 1))
    columns.append(TableColumn("task [um]", [in_unit(value["task"], "um") for value in values], 2))
    columns.append(TableColumn("proven efficiency [%]", [None if e is None else 100 * e for e in efficiency], 2))
    return ResultTable(
        "observability",
        "Observability of the chosen poses, at nominal parameters",
        tuple(columns),
        (
            "columns of the Jacobian in units of 2 mm and 1.5 deg; no measurement, real or simulated, enters",
            f"task: predicted RMS error over all {len(study.joints)} poses, for noise of"
            f" {quantity_text(SIGMA, 'um', '.0f')}",
        ),
    )


def study_findings(study: PaperStudy) -> tuple[str, ...]:
    """Say in words what the tables show."""
    return (_exact_finding(study), *_ranking_findings(study), *_floor_findings(study))


def _exact_finding(study: PaperStudy) -> str:
    units = study.robot.parameters.per_si
    exact = float(np.max(np.abs((study.exact.robot.values - table1().actual) * units)))
    return (
        f"Without noise, {study.robot.is_free.sum()} parameters come back to within {exact:.1e} (mm or deg); in the"
        " paper to its three printed decimals."
    )


def _rankings(names: tuple[str, ...], errors: FloatArray) -> dict[str, Ranking]:
    """Rankings by the mean and by the largest error, from errors (n_draws, n_sets, 4)."""
    return {what: rank(names, errors[:, :, k]) for k, what in enumerate(("mean error", "largest error"))}


def _ranking_findings(study: PaperStudy) -> tuple[str, ...]:
    """How far the paper's order of the indices holds."""
    draws = millimetres(study.validation_errors(study.outcome))
    by_actual = millimetres(np.array([study.validation_errors(outcome).mean(axis=0) for outcome in study.by_actual]))
    orders = [
        f"{what.capitalize()} over {whose}, least first: {ranking}."
        for errors, whose in (
            (draws, f"{count_noun(len(draws), 'draw')} of the noise"),
            (by_actual, count_noun(len(by_actual), "actual robot")),
        )
        for what, ranking in _rankings(study.names, errors).items()
    ]
    ours = _rankings(study.names, draws)["mean error"]
    return (f"{orders[0]} ({LEGEND}.)", *orders[1:], *_findings_against_paper(ours, study))


def _findings_against_paper(ours: Ranking, study: PaperStudy) -> tuple[str, ...]:
    """The paper's order of the mean error, and ours."""
    printed = {name: values["mean"] for name, values in error_table(2).items() if name != "before"}
    means = dict(zip(ours.names, ours.means.tolist(), strict=True))
    shared = [name for name in ours.names if name in printed]
    paper = sorted((name for name in shared), key=printed.__getitem__)
    here, there = means["uniform"] / means["O1"], printed["uniform"] / printed["O1"]
    o1 = study.selections["O1"]
    best_two = "also" if set(shared[:2]) == set(paper[:2]) else "not"
    nominal = millimetres(np.linalg.norm(study.robot.positions(study.joints)[:, 0] - study.truth, axis=1))
    return (
        f"Before calibration the mean error is {quantity_text(study.nominal_errors()[0], 'mm', '.2f')} here,"
        f" {error_table(2)['before']['mean']:.2f} mm in the paper; at single poses of ours it lies between"
        f" {nominal.min():.2f} and {nominal.max():.2f} mm.",
        f"The paper's order of the mean error, from one draw: {', '.join(paper)}. Its two smallest are {best_two} ours"
        f" among these; its largest, {paper[-1]}, is {'also' if shared[-1] == paper[-1] else 'not'} ours. Kendall's tau"
        f" of the two orders: {agreement(printed, means):.2f} (1: the same order, 0: none).",
        f"Ratio of mean errors, uniform choice to O1: {here:.2f} here, {there:.1f} in the paper. The uniform choice"
        f" has {100 * o1.before['O1'] / o1.after['O1']:.0f} % of the O1 of the best choice from our candidates.",
    )


def _floor_findings(study: PaperStudy) -> tuple[str, ...]:
    """Findings on the theoretical limit and the paper's figure."""
    draws = millimetres(study.validation_errors(study.outcome)[:, 0])
    squares, floor = draws[:, 3] ** 2, millimetres(float(study.floors[0]))
    printed = error_table(2)["O1"]
    rms = float(np.hypot(printed["mean"], printed["std"]))
    reached = 100 * float(np.mean(draws[:, 0] <= printed["mean"]))
    return (
        f"Mean square error of O1's poses over what theory allows: {np.mean(squares) / floor**2:.3f} +-"
        f" {float(standard_error(squares)) / floor**2:.3f}.",
        f"Theory allows {floor:.4f} mm (RMS) at O1's validation poses; the paper's {printed['mean']:.3f} mm (RMS about"
        f" {rms:.4f}) is {'below' if rms < floor else 'above'} that, and {reached:.1f} % of our draws reach it. If its"
        f" +-120 um were the noise in distance, not on each axis, theory would allow {floor / np.sqrt(3):.4f} mm.",
    )

"""How often the verdict is right: simulated calibrations, healthy and sick, and what is said of them.

    python docs/site/verdict_rates.py [--each N] [--processes N] [--out FILE] [--page]

Every scenario of `verdict_scenarios` is run N times on every robot, with seeds 0, 1, ...; healthy scenarios three times
as often, so that both kinds are about as many. FILE gets a row for each scenario; --page puts them into
docs/verdict.md too. The same seeds give the same numbers, however many processes there are.
"""

from __future__ import annotations

import argparse
import re
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from make_examples import EXAMPLES
from verdict_scenarios import ROBOTS, SCENARIOS, open_lab

import calib
from calib.data.tables import format_table
from calib.errors import CalibrationError
from calib.files import write_file
from calib.model.instruments import instruments_of

PAGE = EXAMPLES.parent / "verdict.md"
EACH = 10
HEALTHY_TIMES = 3
OUTCOMES = ("PASS", "CHECK", "FAIL", "refused")
_PLACE = re.compile(r"(<!-- begin verdict rates -->\n).*?(<!-- end -->)", re.DOTALL)


@dataclass(frozen=True)
class Run:
    """One simulated calibration.

    Attributes:
        robot, scenario: Of `ROBOTS` and `SCENARIOS`.
        seed: Of everything random.
    """

    robot: str
    scenario: str
    seed: int


@dataclass(frozen=True)
class Outcome:
    """What was said.

    Attributes:
        run: Of which calibration.
        grade: PASS, CHECK, FAIL, or `refused` where an error in words came instead of a result.
        codes: Short names of the reasons of this grade.
    """

    run: Run
    grade: str
    codes: tuple[str, ...]


def calibrate(run: Run) -> Outcome:
    """Do one calibration."""
    scenario = SCENARIOS[run.scenario]
    number = list(SCENARIOS).index(run.scenario)
    lab = open_lab(run.robot, int(np.random.SeedSequence([run.seed, number]).generate_state(1)[0]))
    try:
        data, validation = scenario.make(lab).measurements(lab.nominal), None
        if scenario.validate:
            data, validation = data.split(scenario.validate, seed=run.seed)
        robot = lab.nominal if scenario.stated else _without_noise(lab.nominal)
        verdict = calib.fit(robot, data, validation=validation).verdict
    except CalibrationError as error:
        return Outcome(run, "refused", (type(error).__name__,))
    return Outcome(run, verdict.grade, tuple(r.code for r in verdict.reasons if r.grade == verdict.grade))


def _without_noise(robot: calib.Robot) -> calib.Robot:
    description = robot.description.model_copy(update={"sigma": None})
    return replace(robot, description=description, instruments=instruments_of(description, robot.path))


def runs(each: int) -> list[Run]:
    """Return all calibrations: `each` of every sick scenario on every robot, and more of the healthy ones."""
    return [
        Run(robot, name, seed)
        for robot in ROBOTS
        for name, scenario in SCENARIOS.items()
        for seed in range(each * (HEALTHY_TIMES if scenario.kind == "healthy" else 1))
    ]


def carry_out(wanted: Iterable[Run], processes: int) -> list[Outcome]:
    """Do calibrations, in the order given."""
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        return list(pool.map(calibrate, wanted, chunksize=4))


def rows(outcomes: Iterable[Outcome]) -> list[list[str]]:
    """Return a row for each scenario, and the totals of both kinds: kind, name, runs, counts, reasons."""
    by_scenario: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        by_scenario.setdefault(outcome.run.scenario, []).append(outcome)
    table = []
    for kind in ("healthy", "sick"):
        these = {name: found for name, found in by_scenario.items() if SCENARIOS[name].kind == kind}
        table += [_row(kind, name, found) for name, found in these.items()]
        table.append(_row(kind, f"all {kind}", [outcome for found in these.values() for outcome in found]))
    return table


def _row(kind: str, name: str, found: list[Outcome]) -> list[str]:
    grades = Counter(outcome.grade for outcome in found)
    codes = Counter(code for outcome in found if outcome.grade != "PASS" for code in dict.fromkeys(outcome.codes))
    said = ", ".join(f"{code} {count}" for code, count in codes.most_common(3))
    return [kind, name, str(len(found)), *(str(grades[grade]) for grade in OUTCOMES), said]


def csv_text(table: list[list[str]]) -> str:
    """Return the rows as a CSV file."""
    head = ("kind", "scenario", "runs", *OUTCOMES, "reasons")
    columns: list[tuple[str, list[object]]] = [(name, [row[k] for row in table]) for k, name in enumerate(head)]
    return format_table(columns, ("Verdicts on simulated calibrations: python docs/site/verdict_rates.py --page",))


def markdown(table: list[list[str]]) -> str:
    """Return the rows as two Markdown tables."""
    text = []
    for kind in ("healthy", "sick"):
        text += [f"| {kind} | runs | {' | '.join(OUTCOMES)} | most frequent reasons |", "|---|" + "---:|" * 5 + "---|"]
        for _, name, *counts, said in (row for row in table if row[0] == kind):
            text.append(f"| {' | '.join([name, *counts, said.replace('_', chr(92) + '_')])} |")
        text.append("")
    return "\n".join(text)


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--each", type=int, default=EACH, help="calibrations of each sick scenario on each robot")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, help="CSV file")
    parser.add_argument("--page", action="store_true", help="put the table into docs/verdict.md")
    options = parser.parse_args()
    table = rows(carry_out(runs(options.each), options.processes))
    if options.out:
        write_file(options.out, csv_text(table))
    if options.page:
        text = PAGE.read_text(encoding="utf-8")
        write_file(PAGE, _PLACE.sub(lambda place: f"{place[1]}{markdown(table)}{place[2]}", text))
    print(markdown(table))


if __name__ == "__main__":
    main()

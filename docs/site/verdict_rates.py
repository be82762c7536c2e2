"""Rates at which the verdict is right: simulated calibrations, healthy and faulty, and their grades.

    python docs/site/verdict_rates.py [--each N] [--processes N] [--only WORDS] [--kept FILE] [--out FILE] [--page]

Every scenario of `verdict_scenarios` is run N times on every robot, with seeds 0, 1, ...; healthy scenarios six times
as often: few alarms are false, and it takes many runs to count them. FILE gets a row for each scenario; --page puts
them into docs/verdict.md too. --only WORDS runs the scenarios whose names contain them; --kept FILE collects outcomes,
so that a run that was ended goes on where it was. The same seeds give the same numbers, however many processes there
are.
"""

from __future__ import annotations

import argparse
import json
import re
import zlib
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from make_examples import EXAMPLES
from verdict_scenarios import SCENARIOS, Trial, open_lab

import calib
from calib.core.base.errors import CalibrationError
from calib.core.base.files import write_file
from calib.core.base.workers import Workers, results_in_order
from calib.core.data.table_writing import format_table
from calib.core.robots.described_instruments import instruments_of

PAGE = EXAMPLES.parent / "verdict.md"
EACH = 1
HEALTHY_TIMES = 6
OUTCOMES = ("PASS", "CHECK", "FAIL", "refused")
KINDS = {
    "healthy": "healthy",
    "counted": "something is wrong, and the claim includes it at poses like those measured",
    "faulty": "faulty",
    "hidden": "faulty, and no such data can show it",
}
"""Kinds of scenarios, and what their tables are called."""
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
        says_so: Whether what hides the fault was named as not covered.
    """

    run: Run
    grade: str
    codes: tuple[str, ...]
    says_so: bool = False


def calibrate(run: Run) -> Outcome:
    """Do one calibration."""
    scenario = SCENARIOS[run.scenario]
    words = zlib.crc32(run.scenario.encode())  # of the name, so that other scenarios change nothing
    lab = open_lab(run.robot, int(np.random.SeedSequence([run.seed, words]).generate_state(1)[0]), scenario.measured)
    made = scenario.make(lab)
    trial = made if isinstance(made, Trial) else Trial(made)
    try:
        data, validation = trial.data, trial.validation
        if scenario.validate and validation is None:
            data, validation = data.split(validation=scenario.validate, seed=run.seed)
        robot = lab.nominal if scenario.stated else _without_noise(lab.nominal)
        verdict = calib.fit(robot, data, validation=validation, **dict(scenario.settings)).verdict
    except CalibrationError as error:
        return Outcome(run, "refused", (type(error).__name__,))
    codes = tuple(r.code for r in verdict.reasons if r.grade == verdict.grade)
    says_so = bool(scenario.named) and any(scenario.named in text for text in verdict.not_covered)
    return Outcome(run, verdict.grade, codes, says_so)


def _without_noise(robot: calib.Robot) -> calib.Robot:
    description = robot.description.model_copy(update={"sigma": None})
    return replace(robot, description=description, instruments=instruments_of(description, robot.path))


def runs(each: int, only: str = "") -> list[Run]:
    """Return all calibrations: `each` of every faulty scenario on every robot, and more of the healthy ones."""
    return [
        Run(robot, name, seed)
        for turn in range(each)
        for name, scenario in SCENARIOS.items()
        for robot in scenario.robots
        for seed in (range(HEALTHY_TIMES * turn, HEALTHY_TIMES * (turn + 1)) if scenario.kind == "healthy" else [turn])
        if only in name
    ]


def carry_out(planned: Sequence[Run], processes: int, kept: Path | None = None) -> list[Outcome]:
    """Do calibrations, in the order given.

    Args:
        planned: Which.
        processes: How many at once.
        kept: File to which each outcome is added as it comes; what is there already is not done again.
    """
    done = _read(kept) if kept is not None and kept.exists() else {}
    left = [run for run in planned if run not in done]
    with Workers(processes, len(left)) as workers:
        for outcome in results_in_order(calibrate, left, workers):
            done[outcome.run] = outcome
            if kept is not None:
                with kept.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(outcome)) + "\n")
    return [done[run] for run in planned]


def _read(kept: Path) -> dict[Run, Outcome]:
    entries = [json.loads(line) for line in kept.read_text(encoding="utf-8").splitlines()]
    outcomes = [Outcome(Run(**e["run"]), e["grade"], tuple(e["codes"]), e["says_so"]) for e in entries]
    return {outcome.run: outcome for outcome in outcomes}


def rows(outcomes: Iterable[Outcome]) -> list[list[str]]:
    """Return a row for each scenario, and the totals of each kind: kind, name, runs, counts, reasons."""
    by_scenario: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        by_scenario.setdefault(outcome.run.scenario, []).append(outcome)
    table = []
    for kind in KINDS:
        these = {name: group for name, group in by_scenario.items() if SCENARIOS[name].kind == kind}
        if not these:
            continue
        table += [_row(kind, name, group) for name, group in these.items()]
        table.append(_row(kind, f"all {kind}", [outcome for group in these.values() for outcome in group]))
    return table


def _row(kind: str, name: str, outcomes: list[Outcome]) -> list[str]:
    grades = Counter(outcome.grade for outcome in outcomes)
    shown = (outcome for outcome in outcomes if outcome.grade != "PASS" or kind == "counted")
    codes = Counter(code for outcome in shown for code in dict.fromkeys(outcome.codes))
    said = ", ".join(f"{code} {count}" for code, count in codes.most_common(3))
    if name in SCENARIOS and SCENARIOS[name].named:
        said = f"a PASS names it as not covered: {sum(o.says_so for o in outcomes if o.grade == 'PASS')}" + (
            f"; {said}" if said else ""
        )
    return [kind, name, str(len(outcomes)), *(str(grades[grade]) for grade in OUTCOMES), said]


def csv_text(table: list[list[str]]) -> str:
    """Return the rows as a CSV file."""
    head = ("kind", "scenario", "runs", *OUTCOMES, "reasons")
    columns: list[tuple[str, list[object]]] = [(name, [row[k] for row in table]) for k, name in enumerate(head)]
    return format_table(columns, ("Verdicts on simulated calibrations: python docs/site/verdict_rates.py --page",))


def markdown(table: list[list[str]]) -> str:
    """Return a Markdown table for each kind: scenarios by their most frequent reason, and the total."""
    text = []
    for kind, heading in KINDS.items():
        text += [f"| most frequent reason | {heading} | runs | {' | '.join(OUTCOMES)} |", "|---|---|" + "---:|" * 5]
        by_reason: dict[str, list[list[str]]] = {}
        *scenarios, total = [row for row in table if row[0] == kind] or [[kind, f"all {kind}", *"00000", ""]]
        for row in scenarios:
            by_reason.setdefault(_first_reason(row[-1]), []).append(row)
        text += [*(_line(reason, group) for reason, group in by_reason.items()), _line("", [total]), ""]
    return "\n".join(text)


def _first_reason(said: str) -> str:
    """Most frequent reason of a row; none for a row without reasons."""
    return "*not covered*" if said.startswith("a PASS names it") else said.partition(" ")[0]


def _line(reason: str, group: list[list[str]]) -> str:
    quiet = group[0][0] == "healthy" and len(group) > 1
    names = f"{len(group)} scenarios without a reason" if quiet else "; ".join(row[1] for row in group)
    counts = " | ".join(str(sum(int(row[k]) for row in group)) for k in range(2, 7))
    return f"| {reason or '-'} | {names} | {counts} |".replace("_", "\\_")


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--each", type=int, default=EACH, help="calibrations of each faulty scenario on each robot")
    parser.add_argument("--only", default="", help="words that the names of scenarios must contain")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--kept", type=Path, help="file that collects outcomes; those in it are not done again")
    parser.add_argument("--out", type=Path, help="CSV file")
    parser.add_argument("--page", action="store_true", help="put the table into docs/verdict.md")
    options = parser.parse_args()
    table = rows(carry_out(runs(options.each, options.only), options.processes, options.kept))
    if options.out:
        write_file(options.out, csv_text(table))
    if options.page:
        text = PAGE.read_text(encoding="utf-8")
        PAGE.write_text(_PLACE.sub(lambda place: f"{place[1]}{markdown(table)}{place[2]}", text), encoding="utf-8")
    print(markdown(table))


if __name__ == "__main__":
    main()

"""Where the processor time of a small fit and its verdict goes, by function.

    python -m tests.benchmarks.shares [--data FOLDER]

Functions are timed while they run, inside the fit and the verdict that a user calls; the least of some rounds counts.
FOLDER holds the measurements of others, as for evaluations.py; without it, the Motoman is left out.
"""

import time
from contextlib import ExitStack, contextmanager
from operator import attrgetter
from unittest import mock

import calib
from calib.core.base.threads import one_blas_thread
from calib.core.judging import verdict
from tests.benchmarks import evaluations
from tests.benchmarks.timing import print_table

SIGMAS = {"arm": 3e-5, "MedRUE": 4e-5, "Motoman": 4.26e-5}
OF_FIT = {
    "closing loops": "Problem.from_data",
    "placing": "place",
    "ranks": "require_identifiable",
    "solving": "solve_from",
    "uncertainty": "uncertainty_at",
}
"""Parts of a fit, and their functions in `calib.core.fitting.fit`."""
OF_VERDICT = {
    "patterns": ("systematic",),
    "scales": ("lengths_scaled", "joints_scaled"),
    "loops": ("check_solution",),
    "reach": ("check_joint_motion",),
}
"""Parts of a verdict, and their rules."""


@contextmanager
def timed():
    """Inside, each part's function adds its seconds to what this gives, by part; what one calls counts for itself."""
    seconds = dict.fromkeys((*OF_FIT, *OF_VERDICT), 0.0)

    def timing(part, function):
        def run(*arguments, **options):
            start = time.process_time()
            result = function(*arguments, **options)
            result = tuple(result) if part in OF_VERDICT else result  # rules yield their reasons
            seconds[part] += time.process_time() - start
            return result

        return run

    part_of = {name: part for part, names in OF_VERDICT.items() for name in names}
    rules = tuple(timing(part_of[rule.__name__], rule) if rule.__name__ in part_of else rule for rule in verdict._RULES)
    with ExitStack() as stack:
        for part, name in OF_FIT.items():
            function = timing(part, attrgetter(name)(calib.core.fitting.fit))
            stack.enter_context(mock.patch(f"calib.core.fitting.fit.{name}", function))
        stack.enter_context(mock.patch.object(verdict, "_RULES", rules))
        yield seconds


@one_blas_thread
def parts(robot, data, sigma, rounds):
    """Least seconds of each part, and of the whole fit and verdict."""
    runs = []
    for _ in range(rounds):
        with timed() as seconds:
            start = time.process_time()
            fit = calib.fit(robot, data, sigma=sigma)
            fitted = time.process_time()
            assert fit.verdict.grade
            runs.append({**seconds, "fit": fitted - start, "verdict": time.process_time() - fitted})
    return {name: min(run[name] for run in runs) for name in runs[0]}


def table(folder, rounds):
    """Lines of the table: milliseconds of this machine, and shares of fit and verdict together."""
    yield f"| fit | fit and verdict | {' | '.join(OF_FIT)} | rest of the fit | verdict | {' | '.join(OF_VERDICT)} |"
    yield "|---|---:|" + "---:|" * (len(OF_FIT) + len(OF_VERDICT) + 2)
    for name, (robot, data) in evaluations.problems(folder).items():
        if name in SIGMAS:
            taken = parts(robot, data, SIGMAS[name], rounds)
            whole = taken["fit"] + taken["verdict"]
            rest = taken["fit"] - sum(taken[part] for part in OF_FIT)
            numbers = [taken[part] for part in OF_FIT] + [rest, taken["verdict"]] + [taken[part] for part in OF_VERDICT]
            shares = " | ".join(f"{100 * number / whole:.0f} %" for number in numbers)
            yield f"| {name}, {len(data)} poses | {1e3 * whole:.1f} ms | {shares} |"


if __name__ == "__main__":
    print_table(__doc__, table, 30)

"""This project, as its page about printers does: `calib init --klipper`, a fit, and the numbers that Klipper gets."""

import contextlib
import io
import sys

import numpy as np
from delta_printer import Printers, value
from exchange import Answer, fit_time, main

import calib
from calib.printers.formats import geometry_of
from calib.starting.command import command


def solve(problem: Printers) -> Answer:
    predicted, grades = [], []
    for k, path in enumerate(problem.files):
        described = path.with_suffix(".yaml")
        # -- what a user writes: two commands, and a third for the lines of printer.cfg
        with contextlib.redirect_stdout(io.StringIO()):
            command(["--klipper", str(path), "--out", str(described)], standalone_mode=False)
        with fit_time():
            fit = calib.fit(calib.load(described), path.with_suffix(".csv"))
        # -- end
        g = geometry_of(fit.robot)
        p = [1e3 * g.radius, *np.degrees(g.angles), *(1e3 * np.array(g.arms)), *(1e3 * np.array(g.endstops))]
        predicted += [1e-3 * value(np.array(p), problem.places(k, places)) for places in problem.unseen[k]]
        grades.append(fit.verdict.grade)
    worst = next(grade for grade in ("FAIL", "CHECK", "PASS") if grade in grades)
    return Answer(np.array(predicted), None, False, worst, f"this project {calib.__version__}")


if __name__ == "__main__":
    sys.exit(main(solve, Printers))

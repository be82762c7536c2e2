"""Klipper's numbers of a delta printer: where the nozzle is, and its calibration, by NumPy and SciPy alone.

A re-implementation: Klipper is a firmware, not a package that pip installs. As its notes on delta calibration say, it
fits the radius, two angles and three endstops to heights of zero over the bed; where distances were measured, arms too,
with heights weighed by the number of distances over half the number of heights.
"""

import configparser
import json
import sys
from pathlib import Path

import numpy as np
import scipy
from scipy.optimize import least_squares

STEPPERS = [f"stepper_{tower}" for tower in "abc"]


class Printers:
    """The files of one problem, and the unseen places."""

    def __init__(self, folder: Path) -> None:
        self.unseen = json.loads((folder / "unseen.json").read_text())
        self.files = [folder / f"fold_{k}.cfg" for k in range(len(self.unseen))]

    def places(self, k: int, texts: list[str]) -> list[np.ndarray]:
        """How far carriages came down [mm], from the steps that a file writes."""
        cfg = configparser.ConfigParser()
        cfg.read(self.files[k])
        each = [cfg[stepper] for stepper in STEPPERS]
        full = [float(section.get("full_steps_per_rotation", "200")) for section in each]
        step = [float(o["rotation_distance"]) / (f * float(o["microsteps"])) for o, f in zip(each, full, strict=True)]
        return [np.array(text.split(","), float) * step for text in texts]


# -- what a user writes, without Klipper
def settings(cfg):
    """Radius, three angles, three arms, three endstops [mm, deg]."""
    each = [cfg[stepper] for stepper in STEPPERS]
    three = [[float(section[key]) for section in each] for key in ("angle", "arm_length", "position_endstop")]
    return np.array([float(cfg["printer"]["delta_radius"]), *np.ravel(three)])


def nozzle(p, down):
    """Where three spheres about the carriages meet, (3,) [mm]."""
    radius, angles, arms, ends = p[0], np.radians(p[1:4]), p[4:7], p[7:10]
    centres = np.column_stack(
        [radius * np.cos(angles), radius * np.sin(angles), ends + np.sqrt(arms**2 - radius**2) - down]
    )
    # the differences of the spheres are two planes; on their line, the first sphere has two points
    A = 2 * (centres[1:] - centres[0])
    b = arms[0] ** 2 - arms[1:] ** 2 + np.sum(centres[1:] ** 2, axis=1) - np.sum(centres[0] ** 2)
    line = np.cross(A[0], A[1])
    start = np.linalg.lstsq(A, b, rcond=None)[0]
    line, off = line / np.linalg.norm(line), start - centres[0]
    half = line @ off
    t = -half + np.array([-1, 1]) * np.sqrt(half**2 - off @ off + arms[0] ** 2)
    return min((start + root * line for root in t), key=lambda point: point[2])


def value(p, places):
    """The height of a place, or the distance of two [mm]."""
    points = [nozzle(p, place) for place in places]
    return points[0][2] if len(points) == 1 else float(np.linalg.norm(points[0] - points[1]))


def calibrated(start, rows):
    """Klipper's fit: six parameters, nine with distances."""
    heights = [len(places) == 1 for _, places in rows]
    spans = len(rows) - sum(heights)
    free = [0, 1, 2, 7, 8, 9, *((4, 5, 6) if spans else ())]
    weight = np.where(heights, np.sqrt(spans / (0.5 * sum(heights))) if spans else 1.0, 1.0)

    def parameters(values):
        p = start.copy()
        p[free] = values
        return p

    def misses(values):
        return np.array([value(parameters(values), places) - measured for measured, places in rows])

    best = least_squares(lambda values: weight * misses(values), start[free], x_scale="jac").x
    return parameters(best), misses(best)
    # -- end


def solve(problem: Printers) -> object:
    from exchange import Answer, fit_time

    predicted, left = [], []
    for k, path in enumerate(problem.files):
        cfg = configparser.ConfigParser()
        cfg.read(path)
        told = cfg["delta_calibrate"]
        names = [key for key in told if key.startswith(("height", "distance")) and "_" not in key]
        ends = ("_pos", "_pos1", "_pos2")
        rows = [(float(told[n]), problem.places(k, [told[n + end] for end in ends if n + end in told])) for n in names]
        with fit_time():
            p, misses = calibrated(settings(cfg), rows)
        predicted += [1e-3 * value(p, problem.places(k, places)) for places in problem.unseen[k]]
        left.append(1e-3 * np.sqrt(np.mean(misses**2)))
    claim = float(np.sqrt(np.mean(np.square(left))))
    return Answer(np.array(predicted), claim, package=f"SciPy {scipy.__version__}, NumPy {np.__version__}")


if __name__ == "__main__":
    from exchange import main

    sys.exit(main(solve, Printers))

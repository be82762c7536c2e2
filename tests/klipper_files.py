"""Delta printers as their owners have them: `printer.cfg` files of Klipper, every row left out in turn.

    python tests/klipper_files.py FOLDER

For each file, root mean squares of what was measured less what is predicted of it from the other rows [mm]: by
Klipper's parameters (its two least-squares problems, solved here without the engine), and by the fit, which weighs rows
and priors as that of all rows does. Then each calibration of one machine on the heights of another, the mean taken off.
FOLDER has files called *.cfg; those of one machine differ in the last character of their names.
"""

import argparse
import re
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from click.testing import CliRunner
from scipy.optimize import least_squares

import calib
from calib.commands.init import command
from calib.exporting.printers import geometry_of
from calib.fitting.problem import Problem


def rms(values):
    return 1e3 * float(np.sqrt(np.mean(np.square(values)))) if len(values) else np.nan


def read(path, folder):
    """Robot and measurements, by `calib init`; microsteps that do not fit are corrected as its message says."""
    text = path.read_text()
    for _ in range(2):
        given = folder / path.name
        given.write_text(text)
        done = CliRunner().invoke(
            command, ["--klipper", str(given), "--out", str(given.with_suffix(".yaml")), "--force"]
        )
        said = re.findall(r"\[stepper_([abc])\] microsteps: (\d+)", done.output)
        if not said:
            break
        print(f"{path.name}: microsteps are corrected to {', '.join(f'{t} {n}' for t, n in said)}")
        for tower, number in said:
            text = re.sub(rf"(\[stepper_{tower}\][^\[]*microsteps: )\d+", rf"\g<1>{number}", text)
    if done.exit_code:
        sys.exit(done.output)
    robot = calib.load(given.with_suffix(".yaml"))
    return robot, calib.read_measurements(given.with_suffix(".csv"), robot), text


def settings(text):
    """Klipper's parameters: radius, three angles, three arms, three endstops [mm, deg]."""

    def of(key):
        return [float(re.search(rf"\[stepper_{t}\][^\[]*\b{key}: ([\d.]+)", text)[1]) for t in "abc"]

    radius = float(re.search(r"delta_radius: ([\d.]+)", text)[1])
    return np.array([radius, *of("angle"), *of("arm_length"), *of("position_endstop")])


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
    return min((start + one * line for one in t), key=lambda point: point[2])


def errors(p, rows):
    found = []
    for measured, places in rows:
        points = [nozzle(p, place) for place in places]
        found.append((points[0][2] if len(points) == 1 else np.linalg.norm(points[0] - points[1])) - measured)
    return np.array(found)


def klipper(start, rows):
    """Klipper's fit: six parameters, nine with distances, which count by its weight."""
    heights = [len(places) == 1 for _, places in rows]
    spans = len(rows) - sum(heights)
    free = [0, 1, 2, 7, 8, 9, *((4, 5, 6) if spans else ())]
    weight = np.where(heights, np.sqrt(spans / (0.5 * sum(heights))) if spans else 1.0, 1.0)

    def residuals(values):
        p = start.copy()
        p[free] = values
        return weight * errors(p, rows)

    p = start.copy()
    p[free] = least_squares(residuals, start[free], x_scale="jac").x
    return p


def as_rows(robot, data):
    """Measured numbers and carriages [mm], in the order of the file."""
    rows = []
    for k in range(len(data)):
        places = 1e3 * data.joints[k].reshape(-1, 3)
        touch = data.readings["probe"]
        if k in touch.visits:
            name = robot.instrument("probe").touched[int(touch.details[list(touch.visits).index(k), 0])]
            rows.append((float(name.removeprefix("at_").removesuffix("_mm").replace("minus_", "-")), places[:1]))
        else:
            read = data.readings["caliper"]
            rows.append((1e3 * float(read.values[list(read.visits).index(k), 0]), places))
    return rows


def firmware(robot):
    """The robot's numbers as Klipper's parameters."""
    g = geometry_of(robot)
    return np.array([1e3 * g.radius, *np.degrees(g.angles), *(1e3 * np.array(g.arms)), *(1e3 * np.array(g.endstops))])


def left_out(fitted, data, start):
    """Rows, and errors at rows left out in turn, by Klipper and by the fit, (2, n_rows) [mm]."""
    robot, rows, found = fitted.nominal, as_rows(fitted.nominal, data), []
    for k in range(len(rows)):
        others = np.delete(np.arange(len(rows)), k)
        solved, _ = Problem(robot, data.subset(others)).solve(robot, fitted.scales.groups)
        fits = klipper(start, [rows[j] for j in others]), firmware(solved)
        found.append([errors(p, rows[k : k + 1])[0] for p in fits])
    return rows, np.array(found).T


def main():
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    given, known = parser.parse_args().folder, {}
    warnings.simplefilter("ignore")
    print("file                 rows  heights: Klipper, calib   distances: the same   seconds a fit")
    better = worse = 0
    with tempfile.TemporaryDirectory() as place:
        for path in sorted(given.glob("*.cfg")):
            robot, data, text = read(path, Path(place))
            begun = time.perf_counter()
            fitted = calib.fit(robot, data)
            seconds = time.perf_counter() - begun
            rows, off = left_out(fitted, data, settings(text))
            spans = np.array([len(places) == 2 for _, places in rows])
            figures = [[rms(e[which] / 1e3) for e in off] for which in (~spans, spans)]
            shown = "   ".join(" ".join(f"{value:8.4f}" for value in one) for one in figures)
            print(f"{path.name:20s} {len(rows):3d}  {shown}   {seconds:9.2f}", flush=True)
            pairs = [one for one in figures if np.isfinite(one[0])]
            worse += any(one[1] > one[0] for one in pairs)
            better += all(one[1] < one[0] for one in pairs)
            known[path.stem] = firmware(fitted.robot), settings(text), [row for row in rows if len(row[1]) == 1]
    print(f"better in all that was left out: {better} files; worse in something: {worse}")
    for one in known:
        for other in known:
            if one != other and one[:-1] == other[:-1]:
                found = [errors(p, known[other][2]) for p in known[one][:2]]
                off = [rms((e - e.mean()) / 1e3) for e in found]
                print(f"{one} on the heights of {other}: Klipper {off[1]:.4f}, calib {off[0]:.4f}")


if __name__ == "__main__":
    main()

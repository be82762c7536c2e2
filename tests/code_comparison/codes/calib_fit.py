"""This project: `origins` as its default, `auto` with joint terms that earn their place, `no-priors` without priors."""

import csv
import sys
from pathlib import Path

import numpy as np
import yaml
from exchange import Answer, Problem, fit_time, main

import calib
from calib.core.base.errors import CalibrationError


def write_table(problem: Problem, path: Path) -> None:
    """Write the rows to fit as a table that the program reads, and markers beside it."""
    joints = problem.joints  # without a unit: SI
    heads = {
        "points": [*joints, *(f"point_{axis} [m]" for axis in "xyz")],
        "sockets": ["setup", *joints, "tool"],
        "pixels": ["pose", *joints, "camera", "point", "pixel_u", "pixel_v"],
    }
    rows, poses, markers = [heads[problem.reads]], dict[tuple[float, ...], int](), dict[tuple[float, ...], str]()
    for q, read in zip(problem.q.tolist(), problem.read.tolist(), strict=True):
        if problem.reads == "points":
            rows.append([*q, *read])
        elif problem.reads == "sockets":
            rows.append([f"place{int(read[0])}", *q, f"s{int(read[1])}"])
        else:
            pose, marker = poses.setdefault(tuple(q), len(poses)), tuple(read[1:4])
            name = markers.setdefault(marker, f"m{len(markers)}")
            rows.append([pose, *q, f"camera{int(read[0])}", name, *read[4:]])
    points = [["point", "x [m]", "y [m]", "z [m]"], *([name, *place] for place, name in markers.items())]
    for where, table in ((path, rows), (path.with_name("markers.csv"), points)):
        with where.open("w", newline="") as stream:
            csv.writer(stream).writerows(table)


def solve(problem: Problem, how: str) -> Answer:
    write_table(problem, problem.folder / "measured.csv")
    # -- what a user writes, as YAML, and one command
    point = {"frame": problem.link, "xyz": problem.point.tolist(), "position": "unknown"}
    point |= {"sigma": problem.point_sigma} if problem.point_sigma else {}
    described = {
        "urdf": "robot.urdf",
        "name_mot": problem.joints,
        "base": {"frame": problem.base} if problem.spacing else {"frame": problem.base, "pose": "unknown"},
        "targets": {"point": point},
        "parametrisation": [
            {"origin": "all", "components": ["x", "y", "z"], "sigma": problem.length_sigma},
            {"origin": "all", "components": ["rx", "ry", "rz"], "sigma": problem.angle_sigma},
        ],
        "priors": how != "no-priors",
    }
    if problem.spacing:
        places = [f"place{int(k)}" for k in np.unique(problem.read[:, 0])]
        sockets = {"s0": [0, 0, 0], "s1": [problem.spacing, 0, 0]}
        artefact = {"frame": problem.base, "pose": "unknown", "points": sockets}
        described["instruments"] = {"tool": {"kind": "touch", "target": "point", "artefact": artefact}}
        described["setups"] = {place: ["tool_artefact"] if place != places[0] else [] for place in places}
    if problem.cameras:
        described["base"] = {"frame": problem.base}
        described["targets"] = {"body": {"frame": problem.link, "position": "unknown", "orientation": "unknown"}}
        camera = {"kind": "pixel", "target": "body", "camera": {"frame": problem.base}, "columns": "pixel"}
        numbers = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
        described["instruments"] = {
            f"camera{k}": camera
            | {"intrinsics": dict(zip(numbers, told["lens"], strict=True)), "points_file": "markers.csv"}
            for k, told in enumerate(problem.cameras)
        }
    (problem.folder / "robot.yaml").write_text(yaml.safe_dump(described))
    robot = calib.load(problem.folder / "robot.yaml")
    try:
        with fit_time():
            fit = calib.fit(robot, problem.folder / "measured.csv", terms="auto" if how == "auto" else None)
        # -- end
    except CalibrationError as error:
        raise SystemExit(str(error).partition("; not separable")[0]) from error
    expected = None if problem.cameras else fit.claim_at(problem.unseen)  # of pixels: says nothing in metres
    told = None if expected is None else expected.rms
    version = f"this project {calib.__version__}"
    if how == "auto":
        version += f" (added: {'+'.join(term.term for term in fit.terms.trials if term.added) or 'nothing'})"
    if problem.cameras:
        points = fit.robot.forward(problem.unseen, problem.link)[:, :3].reshape(-1, 12)
    else:
        points = fit.robot.positions(problem.unseen)[:, 0]
    return Answer(points, told, told is not None, fit.verdict.grade, version)


if __name__ == "__main__":
    sys.exit(main(solve))

"""This project: `origins` as its default, `auto` with joint terms that earn their place, `no-priors` without priors."""

import csv
import sys
from pathlib import Path

import numpy as np
import yaml
from exchange import Answer, Problem, fit_time, main

import calib
from calib.base.errors import CalibrationError
from calib.judging.claim import claim_of


def write_table(problem: Problem, path: Path) -> None:
    """Write the rows to fit as a table that the program reads."""
    joints = [f"{name} [rad]" for name in problem.joints]
    rows = [["setup", *joints, "tool"] if problem.spacing else [*joints, *(f"point_{axis} [m]" for axis in "xyz")]]
    for q, read in zip(problem.q.tolist(), problem.read.tolist(), strict=True):
        rows.append([f"place{int(read[0])}", *q, f"s{int(read[1])}"] if problem.spacing else [*q, *read])
    with path.open("w", newline="") as stream:
        csv.writer(stream).writerows(rows)


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
    (problem.folder / "robot.yaml").write_text(yaml.safe_dump(described))
    robot = calib.load(problem.folder / "robot.yaml")
    try:
        with fit_time():
            fit = calib.fit(robot, problem.folder / "measured.csv", terms="auto" if how == "auto" else None)
        # -- end
    except CalibrationError as error:
        raise SystemExit(str(error).partition("; not separable")[0]) from error
    try:
        claim = claim_of(fit)
    except CalibrationError:
        claim = None
    told = None if claim is None else claim.told.rms
    version = f"this project {calib.__version__}"
    if how == "auto":
        version += f" (added: {'+'.join(term.term for term in fit.terms.tried if term.added) or 'nothing'})"
    points = fit.robot.positions(problem.unseen)[:, 0]
    return Answer(points, told, told is not None, fit.verdict.grade, version)


if __name__ == "__main__":
    sys.exit(main(solve))

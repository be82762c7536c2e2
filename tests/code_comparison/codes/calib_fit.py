"""This project: `origins` as its default, `auto` with joint terms that earn their place, `no-priors` without priors."""

import csv
import sys

import numpy as np
import yaml
from exchange import Answer, Problem, fit_time, main

import calib
from calib.base.errors import CalibrationError
from calib.judging.claim import claim_of


def solve(problem: Problem, how: str) -> Answer:
    point = {"frame": problem.link, "xyz": problem.point.tolist(), "position": "unknown"}
    point |= {"sigma": problem.point_sigma} if problem.point_sigma else {}
    described = {
        "urdf": "robot.urdf",
        "name_mot": problem.joints,
        "base": {"frame": problem.base, "pose": "unknown"},
        "targets": {"point": point},
        "parametrisation": [
            {"origin": "all", "components": ["x", "y", "z"], "sigma": problem.length_sigma},
            {"origin": "all", "components": ["rx", "ry", "rz"], "sigma": problem.angle_sigma},
        ],
    }
    if how == "no-priors":
        described["priors"] = False
    rows = [["setup", *(f"{name} [rad]" for name in problem.joints), "point_x [m]", "point_y [m]", "point_z [m]"]]
    if problem.spacing:
        del described["base"]["pose"]
        places = np.unique(problem.read[:, 0]).astype(int)
        artefact = {
            "frame": problem.base,
            "pose": "unknown",
            "points": {"s0": [0, 0, 0], "s1": [problem.spacing, 0, 0]},
        }
        described["instruments"] = {"tool": {"kind": "touch", "target": "point", "artefact": artefact}}
        described["setups"] = {f"place{k}": ["tool_artefact"] if i else [] for i, k in enumerate(places)}
        rows = [["setup", *(f"{name} [rad]" for name in problem.joints), "tool"]]
    for q, read in zip(problem.q, problem.read, strict=True):
        told = [f"s{int(read[1])}"] if problem.spacing else map(repr, read.tolist())
        rows.append([f"place{int(read[0])}" if problem.spacing else "", *map(repr, q.tolist()), *told])
    if not problem.spacing:
        rows = [row[1:] for row in rows]
    with (problem.folder / "measured.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows(rows)
    (problem.folder / "robot.yaml").write_text(yaml.safe_dump(described))

    robot = calib.load(problem.folder / "robot.yaml")
    try:
        with fit_time():
            fit = calib.fit(robot, problem.folder / "measured.csv", terms="auto" if how == "auto" else None)
    except CalibrationError as error:
        raise SystemExit(str(error).partition("; not separable")[0]) from error
    try:
        claim = claim_of(fit)
    except CalibrationError:
        claim = None
    told = None if claim is None else claim.told.rms
    version = f"this project {calib.__version__}"
    if how == "auto":
        version += f" (added: {'+'.join(one.term for one in fit.terms.tried if one.added) or 'nothing'})"
    points = fit.robot.positions(problem.unseen)[:, 0]
    return Answer(points, told, told is not None, fit.verdict.grade, version)


if __name__ == "__main__":
    sys.exit(main(solve))

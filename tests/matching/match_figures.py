"""Simulated controllers of real Universal Robots, matched: the table of docs/howto/pendant.md.

    python -m tests.matching.match_figures FOLDER

FOLDER has `factory_origins.csv`: the joint origins that the maker found of each robot. `robot_19` lost a sign there.
"""

import argparse
import csv
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

import calib
from calib.fleets.ur_kinematics import nominal_origins, ur_urdf
from tests.matching.test_match import joint_values, poses, ur_pairs

EXACT, PRINTED = (6, 2, 3), (3, 2, 3)  # decimals of joints [rad], positions [mm], rotations [rad]
EFFECTS = {
    "": lambda q: np.zeros_like(q),
    "shoulder gives way": lambda q: 3e-4 * np.cos(q[:, [1]]) * np.eye(6)[1],
    "joint 5 turns with joint 4": lambda q: 2e-4 * q[:, [3]] * np.eye(6)[4],
    "elbow gear": lambda q: 1e-4 * np.sin(3 * q[:, [2]]) * np.eye(6)[2],
}
"""Errors of the joints [rad] that a controller computes with."""
SETS = [("", EXACT, 53), ("", PRINTED, 21), *((name, EXACT, 21) for name in EFFECTS if name)]


def robots(folder):
    """Return type and joint origins (6, 6) of each robot whose file is whole."""
    with (folder / "factory_origins.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["robot"].startswith("robot_") and row["robot"] != "robot_19"]
    return [(row["model"], np.array([*row.values()][2:], dtype=float).reshape(6, 6)) for row in rows]


def matched(folder, model, origins, effect, digits, seed):
    """Return the grade of 30 pairs, the error at 95 % of 300 other poses [mm], and whether a claim holds, or None."""
    (folder / "stock.urdf").write_bytes(ur_urdf(nominal_origins(model)))
    q, other = joint_values(seed), joint_values(seed + 1000, 300)
    table = ur_pairs(folder / "pairs.csv", q, poses(q + EFFECTS[effect](q), origins), digits)
    match = calib.match(folder / "stock.urdf", table)
    away = match.fit.robot.positions(other)[:, 0] - poses(other + EFFECTS[effect](other), origins)[:, :3, 3]
    error = np.quantile(np.linalg.norm(away, axis=1), 0.95)
    return match.grade, 1e3 * error, bool(error <= match.agreement.claim) if match.grade == "PASS" else None


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    whole = robots(parser.parse_args().folder)
    with tempfile.TemporaryDirectory() as folder:
        for effect, digits, count in SETS:
            runs = [
                matched(Path(folder), *whole[k % len(whole)], effect, digits, k // len(whole)) for k in range(count)
            ]
            grades, errors, claims = zip(*runs, strict=True)
            true = claims.count(True), len(claims) - claims.count(None)
            print(
                f"{effect or 'as calibrated'}, {digits}: {dict(Counter(grades))}, {max(errors):.3f} mm, claims {true}"
            )


if __name__ == "__main__":
    main()

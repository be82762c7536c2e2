"""pybotics, as its notebook calibrates: least squares of `optimize_accuracy` over parameters that a mask leaves free.

Its mask here is the widest: all modified Denavit-Hartenberg parameters, base and tool position.
"""

import csv
import sys
from importlib.metadata import version

import numpy as np
import scipy.optimize
from exchange import Answer, Problem, fit_time, main, moved
from pybotics.optimization import OptimizationHandler, compute_absolute_errors, optimize_accuracy
from pybotics.robot import Robot
from pybotics.tool import Tool
from scipy.spatial.transform import Rotation


def parameters(row: dict[str, str]) -> list[float]:
    """alpha [rad], a [m], theta [rad], d [m] of a row."""
    alpha, a, theta, d = (float(row[key]) for key in ("alpha [deg]", "a [mm]", "theta [deg]", "d [mm]"))
    return [np.radians(alpha), a / 1e3, np.radians(theta), d / 1e3]


def product(rows: list[dict[str, str]]) -> np.ndarray:
    """The pose, (4, 4), of rows that do not move."""
    pose = np.eye(4)
    for row in rows:
        alpha, a, theta, d = parameters(row)
        turn = Rotation.from_euler("XYZ", [alpha, np.radians(float(row["beta [deg]"])), theta]).as_matrix()
        pose = pose @ moved(turn, np.array([a, 0, 0]) + turn @ [0, 0, d])
    return pose


def solve(problem: Problem) -> Answer:
    if problem.reads != "points":
        raise SystemExit(f"pybotics takes measured positions, no {problem.reads}")
    path = problem.folder / "robot_mdh.csv"
    if not path.is_file():
        raise SystemExit("pybotics takes modified Denavit-Hartenberg parameters, which this chain has none of")
    rows = list(csv.DictReader(line for line in path.read_text().splitlines() if line[0] != "#"))
    at = [k for k, row in enumerate(rows) if row["type"] == "revolute"]
    if len(at) != len(problem.joints) or at != list(range(at[0], at[-1] + 1)):
        raise SystemExit("pybotics takes a chain of revolute joints, all of them measured")
    sign = np.array([float(rows[k]["sign"]) for k in at])
    first, last = (product(part) for part in (rows[: at[0]], rows[at[-1] + 1 :]))
    mdh = np.array([parameters(rows[k]) for k in at])
    # -- what a user writes (beside the table of modified Denavit-Hartenberg parameters)
    robot = Robot.from_parameters(mdh)
    robot.world_frame = problem.T_measured_base @ first
    robot.tool = Tool(last)
    robot.tool.position = last[:3, :3] @ problem.p_link_point + last[:3, 3]
    tool = [True, True, True, False, False, False]
    handler = OptimizationHandler(robot, kinematic_chain_mask=[True] * mdh.size, tool_mask=tool, world_mask=True)
    with fit_time():
        result = scipy.optimize.least_squares(
            optimize_accuracy,
            handler.generate_optimization_vector(),
            args=(handler, sign * problem.q, problem.read),
            ftol=1e-6,
            max_nfev=40,
        )
        handler.apply_optimization_vector(result.x)
    errors = compute_absolute_errors(sign * problem.q, problem.read, handler.robot)
    # -- end
    points = np.array([handler.robot.fk(q)[:3, 3] for q in sign * problem.unseen])
    return Answer(points, float(np.sqrt(np.mean(errors**2))), package=f"pybotics {version('pybotics')}")


if __name__ == "__main__":
    sys.exit(main(solve))

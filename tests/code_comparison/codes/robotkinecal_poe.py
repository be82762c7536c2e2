"""robotkinecal, as its readme calibrates a robot of a URDF: screw axes, observed points in the robot's base."""

import sys
from importlib.metadata import version
from xml.etree import ElementTree

import numpy as np
import roboticstoolbox as rtb
from exchange import Answer, Problem, fit_time, main
from robotkinecal import SerialRobotKineCal


def solve(problem: Problem) -> Answer:
    if problem.reads != "points":
        raise SystemExit(f"robotkinecal takes measured points or poses, no {problem.reads}")
    axes = {joint.find("axis").get("xyz") for joint in ElementTree.parse(problem.folder / "robot.urdf").findall("joint")
            if joint.get("name") in problem.joints}  # fmt: skip
    if any(np.any(np.abs(np.array(axis.split(), float) - [0, 0, 1]) > 1e-9) for axis in axes):
        raise SystemExit(
            "robotkinecal takes every joint to turn about its z axis, as its source says; here some do not"
        )
    # -- what a user writes
    T = np.linalg.inv(problem.T_measured_base)
    observed = problem.read @ T[:3, :3].T + T[:3, 3]
    xyz = " ".join(map(str, problem.p_link_point))
    joint = f'<joint name="to_point" type="fixed"><parent link="{problem.link}"/><child link="point"/>'
    point = f'{joint}<origin xyz="{xyz}" rpy="0 0 0"/></joint><link name="point"/></robot>'
    with_point = (problem.folder / "with_point.urdf").absolute()
    with_point.write_text((problem.folder / "robot.urdf").read_text().replace("</robot>", point))
    calibration = SerialRobotKineCal(rtb.ERobot.URDF(str(with_point)), "point")
    calibration.set_observations(list(problem.q), list(observed))
    with fit_time():
        result = calibration.solve()
    errors = np.array(result.iteration_results[-1].position_errors)
    # -- end
    if not result.has_converged:
        raise SystemExit(
            f"it did not converge, and says so (RMS of its last residuals: {1e3 * np.sqrt(np.mean(errors**2)):.3g} mm)"
        )
    own = np.array([calibration.forward_kinematics(len(problem.joints) + 1, q).t for q in problem.unseen])
    points = own @ problem.T_measured_base[:3, :3].T + problem.T_measured_base[:3, 3]
    return Answer(points, float(np.sqrt(np.mean(errors**2))), package=f"robotkinecal {version('robotkinecal')}")


if __name__ == "__main__":
    sys.exit(main(solve))

"""FIGAROH, as its examples calibrate: a configuration, a class with its cost function, `initialize` and `solve`.

`structural`, its default: parameters that random poses tell apart. `excitation`: those that the measured poses
determine to about the sizes that all codes are told. `map`: every parameter, with priors of these sizes.
"""

import csv
import sys
from importlib.metadata import version

import numpy as np
import yaml
from exchange import Answer, Problem, fit_time, main
from figaroh.calibration import BaseCalibration
from figaroh.calibration.calibration_tools import calc_updated_fkm
from figaroh.tools.load_robot import load_robot


class Calibration(BaseCalibration):
    # -- what a user writes, and the configuration below
    def cost_function(self, var):
        estimated = calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)
        return self._compute_logmap_residuals(self.PEE_measured, estimated, position_frame="world")


def solve(problem: Problem, how: str) -> Answer:
    if problem.reads != "points":
        raise SystemExit(f"FIGAROH takes measured positions or poses, and contacts with planes, no {problem.reads}")
    table, settings = (problem.folder.absolute() / name for name in ("figaroh.csv", "figaroh.yaml"))
    with table.open("w", newline="") as stream:
        rows = csv.writer(stream)
        rows.writerow(["x1", "y1", "z1", *problem.joints])
        rows.writerows(np.hstack([problem.read, problem.q]).tolist())
    sizes = {"translation": problem.length_sigma, "rotation": problem.angle_sigma}
    priors = sizes | {"prismatic_offset": problem.length_sigma, "joint_offset": problem.angle_sigma}
    estimation = {"method": how} if how == "structural" else {"method": how, "priors": priors}
    marker = {"name": "point", "measurable_dof": [True] * 3 + [False] * 3, "sensor_type": "laser_tracker"}
    task = {
        "enabled": True,
        "parameters": {"calibration_level": "full_params", "outlier_threshold": 0.05, "estimation": estimation},
        "kinematics": {"base_frame": problem.base, "tool_frame": problem.link},
        "measurements": {"markers": [marker | {"reference_joint": problem.joints[-1]}]},
        "data": {"source_file": str(table), "number_of_samples": len(problem.q)},
    }
    robot = {"name": "arm", "properties": {"joints": {"active_joints": problem.joints}}}
    settings.write_text(yaml.safe_dump({"robot": robot, "tasks": {"calibration": task}}))
    calibration = Calibration(load_robot(str(problem.folder / "robot.urdf"), load_by_urdf=True), str(settings))
    calibration.calib_config |= {"known_baseframe": False, "known_tipframe": False}
    with fit_time():
        calibration.initialize()
        result = calibration.solve(enable_logging=False)
    # -- end
    config = calibration.calib_config | {"NbSample": len(problem.unseen)}
    q = np.tile(calibration.robot.q0, (len(problem.unseen), 1))
    q[:, config["config_idx"]] = problem.unseen
    points = calc_updated_fkm(calibration.model, calibration.data, result.x, q, config).reshape(3, -1).T
    left = calibration.PEE_measured - calibration.get_pose_from_measure(result.x)
    claim = float(np.sqrt(3 * np.mean(left**2)))
    return Answer(points, claim, package=f"FIGAROH {version('figaroh')} ({len(result.x)} parameters)")


if __name__ == "__main__":
    sys.exit(main(solve))

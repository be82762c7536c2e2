"""Processor time and memory of a fit with joint terms chosen, of a chain of many joints.

    python -m tests.benchmarks.many_joints [JOINTS] [POSES]

The chain is simulated: origins that are off, a once-a-turn error of each joint, one three times a turn, noise of
0.1 mm. What it prints is one row of a table: time of the fit without terms, with terms, of the verdict; most memory.
"""

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import calib
from tests.benchmarks.timing import least, peak_memory

SIGMA = 1e-4
AXES = ("0 0 1", "0 1 0", "1 0 0")
DESCRIPTION = """urdf: chain.urdf
name_mot: [{joints}]
base: {{frame: link0, pose: unknown}}
targets: {{ball: {{frame: link{last}, xyz: [50 mm, 20 mm, 100 mm], position: unknown, sigma: 5 mm}}}}
instruments:
  tracker: {{kind: position, target: ball}}
parametrisation:
  - {{origin: all, components: [x, y, z], sigma: 1 mm}}
  - {{origin: all, components: [rx, ry, rz], sigma: 3 mrad}}
"""


def write_chain(folder, n, rng):
    """Write a robot of n turning joints, one after another, their axes in turn along z, y and x; return its path."""
    text = '<robot name="chain"><link name="link0"/>'
    for k in range(n):
        x, y, z = rng.uniform(-0.12, 0.12, 3) + np.array([0.0, 0.0, 0.1])
        text += (
            f'<link name="link{k + 1}"><inertial><mass value="1"/><origin xyz="0 0 0.05"/>'
            '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="j{k + 1}" type="revolute"><parent link="link{k}"/><child link="link{k + 1}"/>'
            f'<origin xyz="{x:.3f} {y:.3f} {z:.3f}"/><axis xyz="{AXES[k % 3]}"/>'
            '<limit lower="-1.5" upper="1.5" effort="100" velocity="1"/></joint>'
        )
    (folder / "chain.urdf").write_text(text + "</robot>")
    path = folder / "chain.yaml"
    path.write_text(DESCRIPTION.format(joints=", ".join(f"j{k + 1}" for k in range(n)), last=n))
    return path


def chain(n, rng):
    """The robot of `write_chain`."""
    with tempfile.TemporaryDirectory() as folder:
        return calib.load(write_chain(Path(folder), n, rng))


def measured(robot, n_poses, rng):
    """Simulated readings of the chain whose origins and joints are off, by the joint values that were commanded."""
    held = robot.description.held
    sigma = np.array([0.0 if p.name in held else p.sigma_si for p in robot.parameters])
    true = robot.with_parameters(robot.values + sigma * rng.standard_normal(len(sigma)))
    n = len(robot.joint_names)
    q = rng.uniform(-1.4, 1.4, (n_poses, n))
    off = 1e-3 * np.sin(q + rng.uniform(0.0, 6.0, n)) * rng.uniform(0.0, 1.0, n) + 3e-4 * np.sin(3.0 * q)
    return replace(calib.simulate(true, q + off, SIGMA, 1), joints=q)


def table(n, n_poses):
    """Lines of the table."""
    robot = chain(n, np.random.default_rng(7))
    data = measured(robot, n_poses, np.random.default_rng(3))
    plain = least(1, fit=lambda: calib.fit(robot, data))["fit"]
    start = time.process_time()
    fit = calib.fit(robot, data, terms="auto")
    chosen = time.process_time()
    grade = fit.verdict.grade
    done = time.process_time()
    terms = ", ".join(f"{trial.term} {trial.size:.3f}" for trial in fit.terms.trials if trial.added)
    yield "| joints | poses | without terms | `--terms auto` | verdict | memory | terms |"
    yield "|---:|---:|---:|---:|---:|---:|---|"
    yield (
        f"| {n} | {n_poses} | {plain:.1f} s | {chosen - start:.1f} s | {done - chosen:.1f} s ({grade})"
        f" | {peak_memory():.2f} GB | {terms} |"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("joints", type=int, nargs="?", default=20)
    parser.add_argument("poses", type=int, nargs="?", default=400)
    given = parser.parse_args()
    print("\n".join(table(given.joints, given.poses)))

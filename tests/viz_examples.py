"""Examples that the tests of the viewer and the report share: MedRUE measured with Table I's actual parameters."""

import numpy as np

import calib
import medrue
from calib.data.measurements import single_readings
from medrue.closed_form import forward
from medrue.paper_tables import table1
from medrue.workspace import target_workspace
from viz.poses import PoseTable


def medrue_robot():
    return calib.load(medrue.robot_file())


def measurements(rows, seed=1, sigma=4e-5, path="memory"):
    """Simulated measurements at these rows of the target workspace; positions from the closed form."""
    rows = np.asarray(rows)
    q = target_workspace().q[rows]
    positions = forward(q, table1().actual).p_world_tool + np.random.default_rng(seed).normal(0, sigma, (len(q), 3))
    names = tuple(str(row) for row in rows)
    return single_readings(calib.Poses(q, names, names, path, ()), positions[:, None, :])


def medrue_fit(identification=range(0, 420, 5), validation=range(3, 420, 9)):
    held_out = None if validation is None else measurements(validation, seed=2)
    return calib.fit(medrue_robot(), measurements(identification), validation=held_out)


def many_poses(n):
    """MedRUE's nominal and calibrated robots and a pose table of `n` poses around the target workspace."""
    nominal = medrue_robot()
    calibrated = nominal.with_parameters(dict(zip(table1().names, table1().actual, strict=True)))
    generator = np.random.default_rng(0)
    q = np.resize(target_workspace().q, (n, 6)) + generator.normal(0, 2e-3, (n, 6))
    before, after = (robot.positions(q)[:, 0] for robot in (nominal, calibrated))
    groups = tuple(generator.choice(["identification", "validation"], n).tolist())
    table = PoseTable(
        q,
        after + generator.normal(0, 4e-5, (n, 3)),
        before,
        after,
        np.full(n, 4e-5),
        np.full((n, 3), np.nan),
        groups,
        generator.random(n) < 0.002,
        tuple(map(str, range(n))),
        ("tool",) * n,
    )
    return nominal, calibrated, table

"""Examples that the tests of the viewer and the report share: MedRUE measured with Table I's actual parameters."""

import dataclasses
import functools
import re
from datetime import UTC, datetime

import numpy as np

import calib
import medrue
from calib.core.data.in_memory import measurements as put_together
from calib.core.data.in_memory import plain_readings
from medrue.closed_form import forward
from medrue.paper_tables import table1
from medrue.workspace import target_workspace
from tests.project import EXAMPLES
from tests.urdf_trees import plain
from viz.inputs import gather
from viz.poses import PoseTable
from viz.report_page import report_page

NOON = datetime(2026, 1, 2, 12, 0, tzinfo=UTC)


def medrue_robot():
    return calib.load(medrue.robot_file())


def measurements(rows, seed=1, sigma=4e-5, path="memory"):
    """Simulated measurements at these rows of the target workspace; positions from the closed form."""
    rows = np.asarray(rows)
    q = target_workspace().q[rows]
    positions = forward(q, table1().actual).p_world_tool + np.random.default_rng(seed).normal(0, sigma, (len(q), 3))
    names = tuple(str(row) for row in rows)
    return put_together(calib.Poses(q, names, names, path, ()), {"tool": plain_readings(positions)})


@functools.cache
def medrue_fit(identification=range(0, 420, 5), validation=range(3, 420, 9)):
    held_out = None if validation is None else measurements(validation, seed=2)
    return calib.fit(medrue_robot(), measurements(identification), validation=held_out)


@functools.cache
def five_bar_fit():
    folder = EXAMPLES
    return calib.fit(calib.load(folder / "five_bar.yaml"), folder / "five_bar_simulated.csv", validation=0.25)


@functools.cache
def spoiled_fit(**options):
    """A fit of readings of which one is 1 mm off."""
    return calib.fit(medrue_robot(), spoiled(measurements(range(0, 420, 5))), **options)


def saved_scene(fit, folder):
    """What the viewer shows of a result folder."""
    fit.save(folder / "out", pages=False)
    return gather(fit.nominal, folder / "out").scene


def assert_saved_alike(fit, folder):
    """Compare what the viewer shows of a fit and of its result folder, whose scene is returned."""
    own, saved = gather(fit.nominal, fit).scene, saved_scene(fit, folder)
    for mine, theirs in zip((own.poses, *own.readings), (saved.poses, *saved.readings), strict=True):
        for field in dataclasses.fields(mine):
            values, again = getattr(mine, field.name), getattr(theirs, field.name)
            if isinstance(values, np.ndarray):
                np.testing.assert_allclose(again, values, rtol=1e-5, atol=1e-9, err_msg=field.name)
            else:
                assert again == values, field.name
    sizes = [[item[state] for other in scene.others for item in other["sets"] for state in ("before", "after")]
             for scene in (own, saved)]  # fmt: skip
    np.testing.assert_allclose(*sizes, rtol=1e-7)
    return saved


LOST_MESH = """<robot name="arm">
 <link name="root"><visual><geometry><mesh filename="lost.stl"/></geometry></visual></link><link name="tip"/>
 <joint name="a" type="revolute"><parent link="root"/><child link="tip"/><origin xyz="1 0 0"/><axis xyz="0 1 0"/>
 <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


def outside_addresses(html):
    """Where a page would ask others for something."""
    shown = re.sub(r"<script.*?</script>", "", html, flags=re.S)
    return re.findall(r"""(?:src|href|url)\s*[=(]\s*["']?(?!["']?(?:data:|#))""", shown)


def undrawn(fit, **options):
    """The report of a fit without its scripts, which are long."""
    return re.sub(r"<script.*?</script>", "", report_page(fit, created=NOON, **options).html, flags=re.S)


def words_of(html):
    """What a page says, without what it draws."""
    return " ".join(re.sub(r"<[^>]+>", " ", re.sub(r"<(svg|style|script).*?</\1>", " ", html, flags=re.S)).split())


LONG_NAMES = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint",
              "the_joint_whose_name_nobody_wanted_to_shorten")  # fmt: skip


def long_named_fit(folder, repeats=5):
    """An arm with the names that robots have, not those of papers, measured several times at each pose."""
    joints = [
        (name, "revolute", f"link_{k}", f"link_{k + 1}", f'<origin xyz="0 {0.05 * k:.2f} 0.2"/><axis xyz="{axis}"/>')
        for k, (name, axis) in enumerate(zip(LONG_NAMES, ("0 0 1", *3 * ["0 1 0"], "0 0 1", "0 1 0"), strict=True))
    ]
    robot = plain(folder, *joints, ("end", "fixed", "link_6", "flange", '<origin xyz="0.05 0 0.1"/>'))
    generator = np.random.default_rng(3)
    q = np.repeat(generator.uniform(-1.5, 1.5, (40, 6)), repeats, axis=0)
    names = tuple(str(k // repeats + 1) for k in range(len(q)))
    true = robot.with_parameters(robot.values + 3e-4 * generator.standard_normal(len(robot.values)))
    positions = true.positions(q) + generator.normal(0, 8e-5, (len(q), 1, 3))
    data = calib.as_measurements(robot, calib.Poses(q, names, names, "memory", ()), positions)
    kept, held = np.arange(0, 30 * repeats), np.arange(30 * repeats, 40 * repeats)
    return calib.fit(robot, data.subset(kept), validation=data.subset(held))


def medrue_robots():
    """MedRUE, nominal and with Table I's actual parameters."""
    nominal = medrue_robot()
    return nominal, nominal.with_parameters(dict(zip(table1().names, table1().actual, strict=True)))


def pose_table(q, measured, before, after, **changes):
    """A table of one reading of 0.04 mm at each pose, for identification, without uncertainty of the prediction."""
    n = len(q)
    columns = {
        "sigma": np.full(n, 4e-5),
        "spread": np.full((n, 3), np.nan),
        "group": ("identification",) * n,
        "outlier": np.zeros(n, dtype=bool),
        "labels": tuple(map(str, range(n))),
        "targets": ("tool",) * n,
        "readings": np.ones(n, dtype=np.intp),
        "series": ("file.csv",) * n,
        "place": np.arange(n),
    }
    return PoseTable(q, measured, before, after, **(columns | changes))


def medrue_table(q, **changes):
    """MedRUE's nominal and calibrated robots and a table of its measured poses q."""
    robots = medrue_robots()
    before, after = (robot.positions(q)[:, 0] for robot in robots)
    measured = after + np.random.default_rng(3).normal(0, 4e-5, after.shape)
    return *robots, pose_table(q, measured, before, after, **changes)


def many_poses(n):
    """MedRUE's nominal and calibrated robots and a pose table of `n` poses around the target workspace."""
    generator = np.random.default_rng(0)
    q = np.resize(target_workspace().q, (n, 6)) + generator.normal(0, 2e-3, (n, 6))
    groups = tuple(generator.choice(["identification", "validation"], n).tolist())
    return medrue_table(q, group=groups, outlier=generator.random(n) < 0.002)


def spoiled(data, visit=10, by=1e-3):
    """The same measurements of MedRUE, one of them wrong in z."""
    values = data.readings["tool"].values.copy()
    values[visit, 2] += by
    readings = dataclasses.replace(data.readings["tool"], values=values)
    return dataclasses.replace(data, readings={"tool": readings})


def exaggerated(bodies, solid, ghost, pose, factor):
    """M(factor) of `viz.bodies`, (n_joints + 1, 4, 4) [m], as the page's script computes it."""
    start = bodies.matrices(solid, pose)
    return start + factor * (bodies.matrices(ghost, pose) - start)

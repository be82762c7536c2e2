"""MedRUE, nominal and calibrated, at 50 assembled configurations, and small mechanisms with special loops.

Joint values come from the closed form of equations 1 to 17; link poses from Pinocchio reading the exported URDF, and
test_pinocchio.py holds these against the closed form and against `calib`. The other tools are held against them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import yaml

import calib
from calib.exporting.formats import export
from medrue.closed_form import ACTUATED_JOINTS, PASSIVE_JOINTS, forward
from medrue.paper_tables import table1
from medrue.workspace import target_workspace
from tests.exporting.read_back import urdf_links
from tests.project import ROOT

Array = np.ndarray


@dataclass(frozen=True)
class Case:
    """An exported robot and where its links should be.

    Attributes:
        robot: What was exported.
        folder: Exports: robot.urdf, robot.yaml, robot.xml, free.xml, drake.urdf, free_drake.urdf.
        q: Actuated joints, (50, 6).
        joints: Every moving joint's value by name, per configuration.
        poses: Every link's pose in the world by name, per configuration, (4, 4) each.
        tool: Tool positions of the closed form, (50, 3) [m].
    """

    robot: calib.Robot
    folder: Path
    q: Array
    joints: list[dict[str, float]]
    poses: list[dict[str, Array]]
    tool: Array

    def largest_difference(self, label: str, pose: Callable[[dict[str, float], str], Array]) -> float:
        """Largest entry of |pose - expected| over configurations and links [m, rad]; printed for the docs.

        Args:
            label: The tool and the file.
            pose: Where a link is at joint values by name, (4, 4).
        """
        largest = max(
            float(np.abs(pose(values, link) - expected).max())
            for values, links in zip(self.joints, self.poses, strict=True)
            for link, expected in links.items()
        )
        print(f"{label}: largest difference of any link's pose in {len(self.q)} configurations {largest:.1e} m, rad")
        return largest


@pytest.fixture(scope="session", params=[pytest.param("nominal", marks=pytest.mark.amount(0, 1)), "calibrated"])
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Case:
    table = table1()
    values = table.nominal if request.param == "nominal" else table.actual
    robot = calib.load(ROOT / "urdf" / "medrue.yaml").with_parameters(values)
    folder = tmp_path_factory.mktemp(request.param)
    files = {"robot.urdf": "urdf", "robot.yaml": "toolbox", "robot.xml": "mjcf", "drake.urdf": "drake"}
    for name, file_format in files.items():
        export(robot, folder / name, file_format)
    export(robot, folder / "free.xml", "mjcf", free_slide=True)
    export(robot, folder / "free_drake.urdf", "drake", free_slide=True)
    q = target_workspace().q[::8][:50]
    closed = forward(q, values)
    names = (*ACTUATED_JOINTS, *PASSIVE_JOINTS)
    joints = [dict(zip(names, row.tolist(), strict=True)) for row in np.hstack([q, closed.passive])]
    links = urdf_links((folder / "robot.urdf").read_bytes())
    poses = [{link: links(values, link).copy() for link in robot.urdf.links} for values in joints]
    return Case(robot, folder, q, joints, poses, closed.p_world_tool)


def link(name: str, mass: float = 1.0) -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="0.05 0 0"/><mass value="{mass}"/>'
        '<inertia ixx="0.001" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.002"/></inertial></link>'
    )


def joint(name: str, parent: str, child: str, x: float = 0.0, kind: str = "revolute") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{x} 0 0"/><axis xyz="0 0 1"/>'
        '<limit lower="-3" upper="3" effort="10" velocity="10"/></joint>'
    )


def load(folder: Path, *urdf: str, **description: object) -> calib.Robot:
    (folder / "small.urdf").write_text(f'<robot name="small">{"".join(urdf)}</robot>')
    (folder / "small.yaml").write_text(
        yaml.safe_dump({"urdf": "small.urdf", "name_mot": ["motor"], "base": {"frame": "ground"}, **description})
    )
    return calib.load(folder / "small.yaml")


@pytest.fixture
def slider_crank(tmp_path: Path) -> calib.Robot:
    """A crank of 0.1 m, a rod of 0.3 m whose end stays on the x axis: the closure holds y alone, x moves, z is idle."""
    return load(
        tmp_path,
        *map(link, ("ground", "crank", "rod")),
        '<link name="end"/>',
        joint("motor", "ground", "crank"),
        joint("pin", "crank", "rod", 0.1),
        joint("tip", "rod", "end", 0.3, "fixed"),
        closed_loop=[["ground", "end"]],
        type=["3d"],
        closed_loop_axes=[["y"]],
        home={"motor": 0.5, "pin": -0.5 - float(np.arcsin(np.sin(0.5) / 3))},
        targets={"end": {"frame": "end"}},
        parametrisation=[{"origin": "pin", "components": ["x", "z"], "sigma": "1 mm"}],
    )


@pytest.fixture
def four_bar(tmp_path: Path) -> calib.Robot:
    """A parallelogram of 0.2 m by 0.4 m whose coupler is cut in its middle: whole frames meet there."""
    return load(
        tmp_path,
        *map(link, ("ground", "left", "right", "half_1", "half_2")),
        '<link name="cut_1"/><link name="cut_2"/>',
        joint("motor", "ground", "left"),
        joint("a", "left", "half_1", 0.2),
        joint("to_cut_1", "half_1", "cut_1", 0.2, "fixed"),
        joint("foot", "ground", "right", 0.4),
        joint("b", "right", "half_2", 0.2),
        joint("to_cut_2", "half_2", "cut_2", -0.2, "fixed"),
        closed_loop=[["cut_1", "cut_2"]],
        type=["6d"],
        closed_loop_axes=[["x", "y", "rz"]],
        home={"motor": 1.2, "a": -1.2, "foot": 1.2, "b": -1.2},
        targets={"coupler": {"frame": "half_1", "xyz": [0.1, 0.05, 0]}},
        parametrisation=[{"origin": "a", "components": ["x"], "sigma": "1 mm"}],
    )


@pytest.fixture
def tilted(tmp_path: Path) -> calib.Robot:
    """MedRUE with links out of perpendicular by some mrad: its five-bars are no longer planar."""
    content = yaml.safe_load((ROOT / "urdf" / "medrue.yaml").read_text(encoding="utf-8"))
    del content["held"], content["elimination_order"]
    content["urdf"] = str(ROOT / "urdf" / "medrue.urdf")
    content["parametrisation"] = [
        {"origin": "all", "components": ["x", "y", "z"], "sigma": "2 mm"},
        {"origin": "all", "components": ["rx", "ry", "rz"], "sigma": "5 mrad"},
    ]
    (tmp_path / "tilted.yaml").write_text(yaml.safe_dump(content))
    return calib.load(tmp_path / "tilted.yaml").with_parameters(
        {"B1.ry": 2e-3, "D1.rz": -3e-3, "E1_B_origin.x": 5e-4, "q4.rz": 1.5e-3, "B2.ry": -1e-3}
    )

"""Arms that were measured, seen, or brought into sockets: problems as `codes/exchange.py` says, and their errors."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar
from xml.etree import ElementTree

import numpy as np

import calib
from tests.public_data import off_two_points

from .codes import HERE
from .data_set import DataSet, Rows, Split, write_json

sys.path.insert(0, str(HERE))  # what codes share among each other imports as they do
from exchange import moved
from urdf_chain import Chain, placed

__all__ = ["Arm", "Chain", "moved", "placed"]

_CHAIN = """\
urdf: robot.urdf
name_mot: [{joints}]
base: {{frame: {base}}}
targets: {{point: {{frame: {link}, position: unknown}}}}
parametrisation: [{{origin: all, components: [x, y, z], sigma: 1 mm}}]
"""


@dataclass(frozen=True, kw_only=True)
class Arm(DataSet):
    """An arm.

    Attributes:
        urdf: Which of the files is the nominal robot.
        joints, base, link: Names in it.
        point: Nominal place of what is read on the link [m].
        point_sigma: How far off that may be [m]; None: anywhere.
        length_sigma, angle_sigma: How far origins may be off [m, rad].
        spacing: Of two sockets [m], where sockets were touched.
    """

    problem: ClassVar[str] = "arm"
    urdf: str = "robot.urdf"
    joints: tuple[str, ...]
    base: str
    link: str
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    point_sigma: float | None = None
    length_sigma: float = 1e-3
    angle_sigma: float = 3e-3
    spacing: float | None = None

    def write(self, here: Path, split: Split, folder: Path) -> None:
        self.nominal(here / self.urdf).write(folder / "robot.urdf")
        self._write_mdh(folder)
        poses = Chain(folder / "robot.urdf", self.base, self.link, list(self.joints)).poses(split.train.q)
        point = np.array(self.point)
        T, p = (np.eye(4), point) if self.spacing else placed(poses, split.train.read, point, self.point_sigma)
        self.write_problem(split, folder, T_measured_base=T, p_link_point=p)

    def write_problem(self, split: Split, folder: Path, **start: object) -> None:
        """Write the joints, what was read of them, and where a fit may start."""
        names = ("joints", "base", "link", "point", "point_sigma", "length_sigma", "angle_sigma", "spacing")
        rows = {"q": split.train.q, "read": split.train.read, "unseen": split.unseen.q}
        write_json(folder, {name: getattr(self, name) for name in names} | rows | start)

    def nominal(self, path: Path) -> ElementTree.ElementTree[ElementTree.Element]:
        """The nominal robot of a URDF, as codes get it."""
        robot = ElementTree.parse(path)
        for link in robot.iter("link"):
            for shape in [*link.findall("visual"), *link.findall("collision")]:
                link.remove(shape)  # meshes lie elsewhere, and no code needs them
        return robot

    def _write_mdh(self, folder: Path) -> None:
        text = _CHAIN.format(joints=", ".join(self.joints), base=self.base, link=self.link)
        (folder / "chain.yaml").write_text(text)
        try:
            calib.export(calib.load(folder / "chain.yaml"), folder / "robot_mdh.csv", "mdh")
        except calib.CalibrationError:
            (folder / "robot_mdh.csv").unlink(missing_ok=True)

    def errors(self, unseen: Rows, predicted: np.ndarray) -> np.ndarray:
        """Distances [m]; those of sockets from two points as far apart, laid through them."""
        if self.spacing is None:
            return np.linalg.norm(predicted - unseen.read, axis=1)
        return off_two_points(predicted, unseen.read[:, 1], self.spacing)

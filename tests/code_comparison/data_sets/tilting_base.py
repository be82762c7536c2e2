"""Arm on a lifting column on tracks, whose base tilts as the arm moves; a reflector by a total station."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from ..arms import Arm
from ..data_set import Rows, Split, drawn

COLUMN = "column_top_joint"
JOINTS = (COLUMN, *(f"dsr_joint{k}" for k in range(1, 7)))


@dataclass(frozen=True, kw_only=True)
class Stations(Arm):
    """An arm that is placed anew at each height of its column, by the points that its owners measured for that.

    What is read of unseen rows has two numbers more: the height, counted, and whether the point places the arm.
    """

    def nominal(self, path: Path) -> ElementTree.ElementTree[ElementTree.Element]:
        """Two segments of the column move by half its height each, along one line: one moves, by all of it."""
        tree = super().nominal(path)
        segments = {joint.get("name"): joint for joint in tree.findall("joint")}
        moving, resting = segments[COLUMN], segments["column_middle_joint"]
        for joint in (moving, resting):
            mimic = joint.find("mimic")
            joint.find("origin").set("xyz", f"0 0 {mimic.get('offset')}")
            joint.remove(mimic)
        resting.set("type", "fixed")
        moving.find("limit").set("upper", "4")
        tree.getroot().remove(segments["column_prismatic_joint"])
        tree.getroot().remove(next(link for link in tree.findall("link") if link.get("name") == "column_pseudo_tip"))
        return tree

    def errors(self, unseen: Rows, predicted: np.ndarray) -> np.ndarray:
        """Distances [m] of the points that do not place the arm."""
        off = np.full(len(predicted), np.nan)
        for height in np.unique(unseen.read[:, 3]):
            here = unseen.read[:, 3] == height
            places = here & (unseen.read[:, 4] == 1)
            goal, own = unseen.read[places, :3], predicted[places]
            turn, _ = Rotation.align_vectors(goal - goal.mean(axis=0), own - own.mean(axis=0))
            moved = turn.apply(predicted[here] - own.mean(axis=0)) + goal.mean(axis=0)
            off[here] = np.linalg.norm(moved - unseen.read[here, :3], axis=1)
        return off[unseen.read[:, 4] == 0]


def _rows(path: Path) -> Rows:
    table = np.genfromtxt(path, delimiter=",", skip_header=1, dtype=str)
    _, height = np.unique(table[:, 2], return_inverse=True)
    places = table[:, 1] == "S"
    return Rows(table[:, 6:13].astype(float), np.column_stack([table[:, 13:16].astype(float), height, places]))


def _splits(folder: Path) -> Iterator[Split]:
    level, _ = drawn(_rows(folder / "flat.csv"), 0, 200)
    for name, words in (("pallet", "on a pallet"), ("outdoor", "outdoors")):
        unseen = _rows(folder / f"{name}.csv")
        yield Split(f"level floor fitted, {words} unseen", Rows(level.q, level.read[:, :3]), unseen)


DATA = Stations(
    name="Tilting base",
    robot="arm on a column on tracks (Trailblazer), its column as one joint",
    instrument="total station, whose stationing points place the base at each height of the column",
    origin="https://github.com/Hilti-Research/construction_robot_stationing_datasets",
    licence="CC BY-NC-SA 3.0",
    columns="flat.csv, pallet.csv, outdoor.csv: pose, S or E, height [m], configuration of the arm, id, time [s],"
    " joints [m, rad], x y z of the reflector [m], readings of two accelerometers [m/s^2]; and their URDF",
    folder="tilting_base",
    files=("flat.csv", "pallet.csv", "outdoor.csv", "trailblazer.urdf"),
    digest="aa499400f9e8b9167c0d7dd0c76221096fc3e49e562dd0d6a0d593706ac802a8",
    urdf="trailblazer.urdf",
    joints=JOINTS,
    base="base_link",
    link="prism",
    point_sigma=5e-3,
    length_sigma=2e-3,
    angle_sigma=5e-3,
    splits=_splits,
    owners="the owners' figures are with the base placed by four of these points",
)

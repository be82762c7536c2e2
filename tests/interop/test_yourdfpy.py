"""yourdfpy: every link of the exported URDF, 50 configurations."""

from functools import partial

import yourdfpy


def test_every_link_is_where_pinocchio_says(case) -> None:
    robot = yourdfpy.URDF.load(str(case.folder / "robot.urdf"), load_meshes=False)
    pose = partial(robot.get_transform, frame_from="world")
    assert case.largest_difference("yourdfpy, URDF", robot.update_cfg, pose) < 1e-9

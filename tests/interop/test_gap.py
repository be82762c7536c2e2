"""What a 3D constraint would have to absorb, and the joints that leave it nothing to absorb."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.core.base.errors import InputError
from calib.core.results.urdf import urdf_bytes
from calib.exporting.closed_model import closed_model
from calib.exporting.formats import export
from calib.exporting.gap import free_directions, free_joints, loop_gaps, poses_near_home
from tests.exporting.read_back import urdf_links
from tests.urdf_trees import plain


def test_the_papers_parameters_keep_the_five_bars_planar(case) -> None:
    gaps = loop_gaps(case.robot)
    assert [(gap.name, gap.direction) for gap in gaps] == [("E1_B-E1_D", "x"), ("E2_B-E2_D", "x")]
    assert all(abs(gap.at_home) < 1e-12 and gap.change < 1e-12 for gap in gaps)
    assert "nothing to absorb" in gaps[0].text()


def test_gaps_of_tilted_links_are_those_that_pinocchio_measures(tilted: calib.Robot) -> None:
    poses = poses_near_home(tilted)
    assert np.array_equal(poses[0], tilted.home)
    links, names, apart = urdf_links(urdf_bytes(tilted)), (*tilted.joint_names, *tilted.passive_names), []
    for row in np.hstack([poses, tilted.assemble(poses).passive]):
        values = dict(zip(names, row, strict=True))
        difference = (np.linalg.inv(links(values, "E1_B")) @ links(values, "E1_D"))[:3, 3]
        assert np.abs(difference[1:]).max() < 1e-11  # the plane itself is closed
        apart.append(difference[0])
    gap = loop_gaps(tilted)[0]
    assert gap.n_poses == len(poses) > 40
    assert gap.at_home == pytest.approx(apart[0], abs=1e-12)
    assert gap.change == pytest.approx(np.abs(np.array(apart) - apart[0]).max(), abs=1e-12)
    assert gap.change > 1e-4
    assert f"the gap is {1e3 * gap.at_home:.4f} mm at home" in gap.text()


@pytest.mark.quick(0)
def test_the_gap_is_said_in_every_export_that_has_it(tilted: calib.Robot, tmp_path) -> None:
    said = f"a 3D constraint would have to absorb up to {1e3 * loop_gaps(tilted)[0].change:.4f} mm"
    for file_format, name in (("mjcf", "a.xml"), ("drake", "a.urdf"), ("toolbox", "a.yaml")):
        export(tilted, tmp_path / name, file_format)
        assert said in (tmp_path / name).read_text(encoding="utf-8")
    for file_format, name in (("mjcf", "b.xml"), ("drake", "b.urdf")):
        assert export(tilted, tmp_path / name, file_format, free_slide=True) == ()
        text = (tmp_path / name).read_text(encoding="utf-8")
        assert "would have to absorb" not in text
        assert "E1_B_to_E1_D_free_x" in text


def test_free_slides_stand_where_the_gap_is(tilted: calib.Robot) -> None:
    model = closed_model(tilted, free_slide=True)
    gaps = {f"{gap.name.replace('-', '_to_')}_free_x": gap.at_home for gap in loop_gaps(tilted)}
    assert {name: model.home[name] for name in gaps} == pytest.approx(gaps, abs=1e-12)
    for tie in model.ties:
        assert np.abs(tie.placement.translation).max() < 1e-11


def test_motions_of_the_mechanism_are_told_from_gaps(slider_crank: calib.Robot) -> None:
    with pytest.raises(InputError, match="loop ground-end, direction x"):
        closed_model(slider_crank)
    model = closed_model(slider_crank, free_slide=True)
    assert model.home["ground_to_end_free_x"] == pytest.approx(
        0.1 * np.cos(0.5) + 0.3 * np.cos(np.arcsin(np.sin(0.5) / 3))
    )
    assert model.home["ground_to_end_free_z"] == 0.0


@pytest.mark.parametrize(
    ("free", "are_joints"),
    [
        ("rz", True),
        ("z rz", True),
        ("x y rz", True),
        ("x y z rx", True),
        ("x z", True),
        ("x rz", False),  # a slide across a hinge, and not the second one: no group of motions
        ("rx ry", False),
    ],
)
def test_free_directions_become_joints_where_joints_have_these_motions(four_bar, free: str, are_joints: bool) -> None:
    names = ("x", "y", "z", "rx", "ry", "rz")
    rows = tuple(i for i, name in enumerate(names) if name not in free.split())
    loop = replace(four_bar.mechanism.loops[0], rows=rows)
    robot = replace(four_bar, mechanism=replace(four_bar.mechanism, loops=(loop,)))
    assert free_directions(robot, 0) == tuple(free.split())
    if are_joints:
        assert free_joints(robot, 0) == tuple(free.split())
        return
    with pytest.raises(InputError, match="are not the motions of one joint"):
        free_joints(robot, 0)


def test_a_robot_without_loops_has_no_gaps(tmp_path) -> None:
    robot = plain(tmp_path, ("j", "continuous", "a", "b"))
    assert loop_gaps(robot) == ()
    assert closed_model(robot).ties == ()

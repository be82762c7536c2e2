"""Usual mistakes are named, each made in good measurements of a robot with the expected errors."""

from dataclasses import replace

import numpy as np
import pytest
from six_axis_arm import FREE, YAML, joints, noisy, write_six_axis
from six_axis_arm import measurements as of

import calib
from calib.identification.suspects import likely_mistake
from medrue.closed_form import forward
from medrue.paper_tables import table1
from medrue.workspace import target_workspace

SIGMA = 4e-5


@pytest.fixture(scope="module", params=["known", "unknown"])
def arm(request, tmp_path_factory):
    yaml = YAML.replace("frame: l0", f"frame: l0, pose: {request.param}")
    return calib.load(write_six_axis(tmp_path_factory.mktemp("arm"), yaml + FREE))


@pytest.fixture(scope="module")
def data(arm):
    sigmas = np.array([p.sigma * (p.prior and not p.placement) for p in arm.parameters])
    real = arm.with_parameters(arm.values + sigmas * np.random.default_rng(4).standard_normal(len(sigmas)))
    return noisy(real, joints(60), SIGMA, 1)


def joint_changed(data, change):
    q = data.joints.copy()
    change(q)
    return replace(data, joints=q)


def test_good_measurements_show_no_mistake(arm, data):
    assert likely_mistake(arm, data) == ""


def test_measurements_of_other_poses_show_no_mistake(arm, data):
    assert likely_mistake(arm, replace(data, joints=data.joints[::-1])) == ""


@pytest.mark.parametrize("j", range(6))
def test_a_joint_that_counts_the_other_way_is_named(arm, data, j):
    wrong = joint_changed(data, lambda q: q.__setitem__((slice(None), j), -q[:, j]))
    assert likely_mistake(arm, wrong).startswith(f"it looks as if joint j{j + 1} counted the other way")


def test_swapped_columns_are_named(arm, data):
    wrong = replace(data, joints=data.joints[:, [0, 2, 1, 3, 4, 5]])
    assert "columns of joints j2 and j3 were swapped" in likely_mistake(arm, wrong)


@pytest.mark.parametrize(
    ("factor", "words"),
    [(np.degrees(1), "degrees were read as radians"), (np.radians(1), "radians were read as degrees")],
)
def test_angles_in_the_wrong_unit_are_named(arm, data, factor, words):
    assert words in likely_mistake(arm, replace(data, joints=factor * data.joints))


@pytest.mark.parametrize(("factor", "words"), [(1e3, "mm were read as m"), (1e-3, "m were read as mm")])
def test_positions_in_the_wrong_unit_are_named(arm, data, factor, words):
    assert words in likely_mistake(arm, replace(data, positions=factor * data.positions))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: p * [1, -1, 1], "y of the measured positions had the wrong sign"),
        (lambda p: p[..., [2, 1, 0]], "x and z of the measured positions were swapped"),
    ],
)
def test_a_left_handed_measurement_frame_is_named(arm, data, change, words):
    found = likely_mistake(arm, replace(data, positions=change(data.positions)))
    assert words in found or ("left-handed" in found and arm.description.base.pose == "unknown")


def test_a_closed_loop_robot_whose_loops_stay_open_is_told_the_mistake(medrue):
    q = np.array(target_workspace().q)[::20]
    swapped = of(q[:, [0, 1, 3, 2, 4, 5]], forward(q, table1().actual).p_world_tool[:, None])
    with pytest.raises(calib.UnreachablePoseError, match="columns of joints q3 and q4 were swapped"):
        calib.fit(medrue, swapped)


def test_a_failed_fit_begins_with_the_mistake(arm, data):
    wrong = joint_changed(data, lambda q: q.__setitem__((slice(None), 2), -q[:, 2]))
    verdict = calib.fit(arm, wrong).verdict
    assert verdict.grade == "FAIL"
    assert verdict.to_dict()["codes"][0] == "likely_mistake"

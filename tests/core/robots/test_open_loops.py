"""Why a pose cannot be assembled: each reason against geometry done elsewhere."""

import re

import numpy as np
import pytest

import calib
from calib.core.data.in_memory import as_measurements
from calib.core.robots.loops import why_open
from medrue.closed_form import PASSIVE_JOINTS, forward
from medrue.paper_tables import table1
from tests.small_robots import write_pose_loop


def test_a_pose_beyond_a_passive_limit_names_the_joint_and_its_angle_in_the_closed_form(medrue):
    q = medrue.home.copy()
    q[1:3] = -1.5
    with pytest.raises(calib.UnreachablePoseError) as error:
        medrue.assemble(q)
    match = re.search(
        r"only with passive joint (\w+) at (\S+) deg, beyond its limits \(-149 to -17.19 deg\)", str(error.value)
    )
    expected = np.degrees(forward(q[None], table1().nominal).passive[0, PASSIVE_JOINTS.index(match[1])])
    assert (float(match[2]) - expected) % 360 == pytest.approx(0, abs=0.05)  # printed with four digits


def test_no_limit_is_named_that_holds(medrue):
    """A pose that fails among others only, because their ways lead elsewhere, is closed alone within all limits."""
    why = why_open(medrue.mechanism, medrue.mode, medrue.home)
    assert why.startswith("it closes if solved alone")
    assert not any(name in why for name in medrue.mechanism.passive)


@pytest.mark.quick(0)
def test_a_limit_of_a_passive_joint_is_no_wall_on_the_way_of_a_fit(medrue):
    """A pose ends within the limits of a slide, but is beyond them for most values on the way."""
    robot, table = medrue, table1()
    rng = np.random.default_rng(90)
    values = table.nominal + rng.choice([-1.0, 1.0], len(table.names)) * (table.actual - table.nominal)
    truth = robot.with_parameters(dict(zip(table.names, values, strict=True)))
    q = robot.sample(40, seed=rng)
    q = q[truth.close(q).ok]
    measured = forward(q, values).p_world_tool + 2e-5 * rng.standard_normal((len(q), 3))
    fit = calib.fit(robot, as_measurements(robot, q, measured))
    assert fit.converged
    new = robot.sample(60, seed=rng)
    new = new[truth.close(new).ok & fit.robot.close(new).ok]
    off = fit.robot.positions(new)[:, 0] - forward(new, values).p_world_tool
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) < 4e-5


def test_a_full_pose_home_that_is_turned_apart_is_refused_in_degrees(tmp_path):
    path = write_pose_loop(tmp_path)
    text = path.read_text()
    turn = float(re.search(r"tip_right_turn: (\S+)}", text)[1])
    path.write_text(text.replace(repr(turn), repr(turn + 0.1)))
    with pytest.raises(
        calib.DescriptionError, match=r"open by \d\.\d+ mm and 5\.\d+ deg; .*to \d+ mm and 3 deg or better"
    ):
        calib.load(path)

"""Wrong statements about machines that read no positions fail, and are named; the machines are those of redundancy."""

from dataclasses import replace

import numpy as np
import pytest
from test_redundancy import driven, machined, pointed, sighted, spooled

import calib
from calib.core.fitting.likely_mistakes import likely_mistake
from calib.core.judging.verdict import judge


def made(case, folder):
    """Nominal robot and measurements of a machine."""
    data = case(folder)[2](np.random.default_rng(1))
    return data.robot, data


def with_readings(data, name, change):
    return replace(
        data, readings={**data.readings, name: replace(data.readings[name], values=change(data.readings[name].values))}
    )


def with_joint(data, j, change):
    joints = data.joints.copy()
    joints[:, j] = change(joints[:, j])
    return replace(data, joints=joints)


MISTAKES = {
    "an encoder": (driven, lambda d: with_readings(d, "encoder", np.negative), "encoder counts the other way"),
    "counts": (driven, lambda d: with_readings(d, "encoder", lambda v: 2 * v), "encoder was 2 times as far"),
    "an axis": (machined, lambda d: with_joint(d, 4, np.negative), "joint c has the wrong sign"),
    "inches": (
        machined,
        lambda d: replace(d, joints=d.joints / [25.4, 25.4, 25.4, 1, 1]),
        "joint values: inches read as mm",
    ),
    "a motor": (spooled, lambda d: with_readings(d, "b", np.negative), "b counts the other way"),
    "motors": (
        spooled,
        lambda d: replace(d, readings={**d.readings, "a": d.readings["b"], "b": d.readings["a"]}),
        "the columns of a and b were swapped",
    ),
    "azimuths": (
        pointed,
        lambda d: with_readings(d, "star", lambda v: v * [-1, 1]),
        "azimuths count the other way",
    ),
    "a joint": (sighted, lambda d: with_joint(d, 2, np.negative), "j3 has the wrong sign"),
    "centimetres": (
        sighted,
        lambda d: with_readings(d, "eye", lambda v: v / 10),
        "positions in cm were read as mm",
    ),
}


@pytest.mark.parametrize("what", MISTAKES)
def test_a_mistake_is_named(tmp_path, what):
    case, mistake, words = MISTAKES[what]
    robot, data = made(case, tmp_path)
    said = likely_mistake(robot, mistake(data))
    assert said.startswith(f"probable mistake: {words}")
    assert likely_mistake(robot, data) == ""


@pytest.mark.parametrize("what", ["an encoder", "an axis", "motors", "azimuths", "centimetres"])
def test_a_fit_of_mistaken_readings_fails(tmp_path, what):
    case, mistake, words = MISTAKES[what]
    robot, data = made(case, tmp_path)
    verdict = judge(calib.fit(robot, mistake(data)))
    assert verdict.grade == "FAIL"
    assert words in verdict.reasons[0].text

"""Wrong statements about machines that read no positions fail, and are named; the machines are those of redundancy."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.core.fitting.likely_mistakes import likely_mistake
from calib.core.judging.verdict import judge
from tests.redundancy.test_redundancy import DRIVE, driven, load, machined, pointed, sighted, spooled


def made(case, folder):
    """Nominal robot and measurements of a machine."""
    data = case(folder)[2](np.random.default_rng(1))
    return data.robot, data


def roughly_known(folder):
    """The cable robot whose spools are known to millimetres: else a negative radius explains a wrong sign."""
    robot, true, drawn = spooled(folder)
    text = (folder / "mover.yaml").read_text().replace("sigma: 100 mm", "sigma: 2 mm").replace("10 mm", "0.3 mm")
    (folder / "mover.yaml").write_text(text)
    robot = calib.load(folder / "mover.yaml")
    return robot, true, lambda rng: replace(drawn(rng), robot=robot)


def two_encoders(folder):
    """Two joints with an encoder behind each drive."""
    urdf = DRIVE.replace("</robot>", "<link name='hand'/><joint name='wrist' type='continuous'><parent link='arm'/>")
    urdf += "<child link='hand'/><axis xyz='0 0 1'/></joint></robot>"
    yaml = "urdf: drive.urdf\nname_mot: [elbow, wrist]\nbase: {frame: ground}\ntargets: {tip: {frame: hand}}\n"
    yaml += "instruments:\n  first: {kind: joint_reading, joint: elbow, zero: unknown}\n"
    yaml += "  second: {kind: joint_reading, joint: wrist, zero: unknown}\n"
    robot = load(folder, "drive.yaml", f"{yaml}parametrisation: [{{joint: all, term: gain, sigma: 20 mrad}}]\n", urdf)

    def drawn(rng):
        q = rng.uniform(-1, 1, (40, 2))
        read = q * [1.01, 0.99] + [0.3, -0.2] + 1e-3 * rng.standard_normal((40, 2))
        return calib.as_measurements(robot, q, {"first": read[:, [0]], "second": read[:, [1]]})

    return robot, {}, drawn


def with_readings(data, name, change):
    readings = data.readings[name]
    return replace(data, readings={**data.readings, name: replace(readings, values=change(readings.values))})


INCHES = np.array([25.4, 25.4, 25.4, 1, 1])
MISTAKES = {
    "an encoder": (driven, lambda d: with_readings(d, "encoder", np.negative), "encoder counts the other way"),
    "counts": (driven, lambda d: with_readings(d, "encoder", lambda v: 2 * v), "encoder was 2 times as far"),
    "an axis": (machined, lambda d: replace(d, joints=d.joints * [1, 1, 1, 1, -1]), "joint c has the wrong sign"),
    "inches": (machined, lambda d: replace(d, joints=d.joints / INCHES), "joint values were inches read as mm"),
    "a motor": (roughly_known, lambda d: with_readings(d, "b", np.negative), "b counts the other way"),
    "columns": (
        two_encoders,
        lambda d: replace(d, readings={"first": d.readings["second"], "second": d.readings["first"]}),
        "the columns of first and second were swapped",
    ),
    "rows, some of which are left out": (
        two_encoders,
        lambda d: replace(d, joints=np.roll(d.joints, 1, axis=0)).subset(np.flatnonzero(np.arange(40) % 4)),
        "all joint values are one row below their measurements",
    ),
    "azimuths": (pointed, lambda d: with_readings(d, "star", lambda v: v * [-1, 1]), "azimuths count the other way"),
    "centimetres": (sighted, lambda d: with_readings(d, "eye", lambda v: v / 10), "positions in cm were read as mm"),
}


def assert_fails_with(words, robot, data):
    verdict = judge(calib.fit(robot, data))
    assert verdict.grade == "FAIL"
    assert words in verdict.reasons[0].text


@pytest.mark.parametrize("what", MISTAKES)
def test_a_mistake_is_named(tmp_path, what):
    case, mistake, words = MISTAKES[what]
    robot, data = made(case, tmp_path)
    said = likely_mistake(robot, mistake(data))
    assert said.startswith("probable mistake: ")
    assert words in said
    if what in ("an encoder", "columns", "an axis", "azimuths"):
        assert_fails_with(words, robot, mistake(data))


@pytest.mark.parametrize("case", [two_encoders, pointed])
def test_no_mistake_is_named_where_there_is_none(tmp_path, case):
    assert likely_mistake(*made(case, tmp_path)) == ""


def test_joints_that_rest_and_joints_that_move_in_few_rows_do_not_fail(tmp_path):
    robot, _, _ = two_encoders(tmp_path)
    rng, q = np.random.default_rng(2), np.zeros((40, 2))
    q[:8, 0] = rng.uniform(-1, 1, 8)
    read = q + [0.3, -0.2] + 1e-3 * rng.standard_normal((40, 2))
    fit = calib.fit(robot, calib.as_measurements(robot, q, {"first": read[:, [0]], "second": read[:, [1]]}))
    assert "noise_as_large_as_robot" not in fit.verdict.to_dict()["codes"]


def test_a_spool_of_negative_radius_fails(tmp_path):
    robot, data = made(spooled, tmp_path)
    said = "the radius of the spool of b is negative: it counts the other way"
    assert_fails_with(said, robot, with_readings(data, "b", np.negative))

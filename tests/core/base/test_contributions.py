"""Mechanisms that numbers of uncertainty contain."""

import re
from importlib import import_module

import numpy as np
import pytest

import calib
from calib.core.base.contributions import Contribution, Uncertainty, names_of
from tests.project import ROOT
from tests.six_axis_arm import FREE, YAML, joints, write_six_axis


@pytest.fixture(scope="module")
def fit(tmp_path_factory):
    """An arm whose fourth joint follows a wave that no parameter describes."""
    arm = calib.load(write_six_axis(tmp_path_factory.mktemp("arm"), YAML + FREE))
    q, rng = joints(60, 1), np.random.default_rng(2)
    actual = q + 3e-4 * np.sin(40 * q) * (np.arange(6) == 3)
    return calib.fit(arm, q, arm.positions(actual)[:, 0] + 3e-5 * rng.standard_normal((60, 3)), sigma=3e-5)


def test_the_page_has_the_mechanisms_and_numbers_of_the_enumeration_and_names_their_modules():
    lines = (ROOT / "docs" / "uncertainty.md").read_text().splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("| mechanism | what it counts |"))
    table = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines[first : lines.index("", first)]]
    assert table[0][2:] == [number.value for number in Uncertainty]
    for own, (link, _, *marks) in zip(Contribution, table[2:], strict=True):
        name, module = re.fullmatch(r"\[(.*)\]\(reference/api/(.*)\.md\)", link).groups()
        assert (name, [mark == "●" for mark in marks]) == (own.value, [number in own.numbers for number in Uncertainty])
        assert import_module(module).__doc__


def test_numbers_carry_what_they_contain(fit):
    assert fit.joint_error > 0
    interval, position = fit.parameters.contains, fit.predict(joints(3)).contains
    assert {Contribution.NOISE, Contribution.SECOND_ORDER} <= interval
    assert {Contribution.NOISE, Contribution.JOINT_ERRORS} <= position
    assert Contribution.JOINT_ERRORS not in interval
    assert Contribution.SECOND_ORDER not in fit.covariance.contains
    assert Contribution.FRAME not in position  # the arm stands where it is known to stand
    assert (Contribution.REGIONS in interval) == (fit.interval_factor > 1)
    assert fit.verdict.claim.contains == {Contribution.LEFT_OUT}


def test_where_no_instrument_stands_at_a_known_place_the_frame_counts(tmp_path):
    far = "{frame: l0, xyz: [1, 0, 0], position: unknown}"
    wire = f"instruments: {{wire: {{kind: distance, target: ball, end: {far}, sigma: 0.02 mm}}}}\n"
    arm = calib.load(write_six_axis(tmp_path, wire + YAML.replace("100 mm]", "100 mm], position: unknown") + FREE))
    poses = calib.Poses(joints(60, 1), *(tuple(map(str, range(60))),) * 2, "simulated", ())
    fit = calib.fit(arm, calib.simulate(arm, poses, None, np.random.default_rng(2)))
    told = fit.identification_uncertainty
    assert (Contribution.FRAME in told.contains) == bool(told.frame)
    assert Contribution.FRAME not in fit.predict(joints(3)).contains  # in the measurement frame


def test_report_and_result_say_it(fit, tmp_path):
    said = fit.to_dict()["contains"]
    assert said["interval"] == names_of(fit.parameters.contains)
    assert said["position"] == names_of(fit.identification_uncertainty.contains)
    report = " ".join(fit.report(verbose=True).split())
    assert f"Intervals of parameters: counts {', '.join(said['interval'])}" in report
    fit.save(tmp_path / "out", pages=False, force=True)
    loaded = calib.load_result(tmp_path / "out")
    assert loaded.parameters.contains == fit.parameters.contains
    assert loaded.predict(joints(3)).contains == fit.predict(joints(3)).contains

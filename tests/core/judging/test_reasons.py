"""Rules of other packages, and the page of reasons; test_every_reason.py makes each reason true and false."""

import dataclasses
import re
from importlib.metadata import EntryPoint
from types import SimpleNamespace

import numpy as np
import pytest

import calib
from calib.core.fitting.pose_checks import tied_joints
from calib.core.judging import rules_model
from calib.core.judging.reasons import Code
from calib.core.judging.verdict import judge
from tests.project import EXAMPLES, ROOT


def told(rule, fit):
    return {reason.code: reason.text for reason in rule(fit)}


def nothing_that_works(fit):
    raise KeyError("no such thing")


def no_reasons(fit):
    yield "it is warm"


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (f"{__name__}:nothing_that_works", "KeyError: 'no such thing'; mend or uninstall the package"),
        (f"{__name__}:not_there", "AttributeError"),
        (f"{__name__}:no_reasons", "yields something other than calib.core.judging.reasons.Reason"),
    ],
)
def test_a_rule_of_another_package_that_does_not_work_is_named(shop, monkeypatch, value, said):
    other = EntryPoint("warmth", value, "calib.reasons")
    listed = {"calib.reasons": [other]}
    monkeypatch.setattr("calib.core.judging.verdict.list_entry_points", lambda group: listed.get(group, []))
    with pytest.raises(calib.InputError, match=re.escape(said)) as result:
        judge(dataclasses.replace(shop.good, seconds=0.0))
    assert str(result.value).startswith(f"reason 'warmth' of the verdict ({value}): ")


def test_every_reason_has_a_row_of_the_page():
    """The page of failures says what to do."""
    page = (ROOT / "docs" / "howto" / "when_it_fails.md").read_text(encoding="utf-8")
    rows = re.findall(r'^\| <a id="(\w+)"></a>\*\*\1\*\*: .+ \| .+ \|$', page, re.MULTILINE)
    assert sorted(rows) == sorted(code.value for code in Code)


@pytest.mark.parametrize("away", [0.0, 7e-5])
def test_few_poses_show_a_gain_by_the_noise_that_is_stated(tmp_path, away):
    """What few poses leave is no measure of chance: by that alone, origins that are 0.07 mm off each would be noise."""
    (tmp_path / "arm.urdf").write_bytes((EXAMPLES / "arm.urdf").read_bytes())
    (tmp_path / "arm.yaml").write_text(
        "urdf: arm.urdf\nname_mot: [joint_1, joint_2, joint_3, joint_4, joint_5, joint_6]\nbase: {frame: base_link}\n"
        "targets: {tip: {frame: flange}}\nparametrisation: [{origin: all, components: [x, z], sigma: 1 mm}]\n"
        "sigma: 0.05 mm\n"
    )
    arm, rng = calib.load(tmp_path / "arm.yaml"), np.random.default_rng(3)
    true = arm.with_parameters(arm.values + away * arm.is_free)
    q = rng.uniform(-1, 1, (4, 6))
    fit = calib.fit(arm, calib.as_measurements(arm, q, true.positions(q)[:, 0] + 5e-5 * rng.standard_normal((4, 3))))
    assert fit.statistics.freedom < 4
    assert ("nothing_to_correct" in told(rules_model.nothing_to_correct, fit)) == (away == 0.0)


def test_of_eighteen_joints_only_those_that_are_tied_are_named():
    """A linkage holds the sum of three passive joints, which an arm reads with all of its others."""
    q = np.random.default_rng(2).uniform(-1, 1, (60, 18)) * np.linspace(0.1, 2.0, 18)
    q[:, 11] = 0.4 - q[:, 4] - q[:, 8]
    names = tuple(f"j{k + 1}" for k in range(18))
    assert tied_joints(SimpleNamespace(joint_names=names), q) == [(("j5", "j9", "j12"), 2)]

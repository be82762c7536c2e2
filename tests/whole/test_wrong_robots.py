"""No robot passes that is not as described: joints that are scaled, targets on another link.

Measurements are simulated. The true robot has the errors that its description expects, and stands where its joints
really are; the file has other joint values, or the description another link.
"""

import re
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest

import calib
from calib.core.base.errors import CalibrationError
from medrue import robot_file
from medrue.workspace import target_workspace
from tests.project import EXAMPLES

SIGMA = {"arm": 3e-5, "ur10e": 3e-5, "five_bar": 2e-5, "medrue": 4e-5}
SCALES = (0.5, 0.7, 0.9, 0.97, 0.985, 1.015, 1.03, 1.1, 1.4, 2.0)
LINKS = {
    "arm": ("link_1", "link_2", "link_3", "link_4", "link_5"),
    "ur10e": ("base_link", "link_1", "link_2", "link_3", "link_4", "link_5"),
    "five_bar": ("table", "left_proximal", "right_proximal", "right_distal"),
}
SETTINGS = tuple(product((True, False), (True, False), (None, None, None, "auto")))
"""Whether the noise is stated, whether poses are held out, and terms."""
REACH = {
    "arm": ([-80, -40, -10, -120, -90, -170], [80, 80, 100, 120, 90, 170]),
    "ur10e": ([-120, -130, -110, -150, -150, -170], [120, -20, 110, 150, 150, 170]),
}
POSES = 80


@dataclass(frozen=True)
class Case:
    """A robot, what is wrong with it, and how it is fitted."""

    name: str
    joint: int = 0
    scale: float = 1.0
    link: str | None = None
    stated: bool = True
    held_out: bool = False
    terms: str | None = None


@cache
def folder():
    """A folder with the robots' files."""
    where = Path(mkdtemp(prefix="wrong_robots_"))
    for name in ("arm", "five_bar"):
        (where / f"{name}.urdf").write_text((EXAMPLES / f"{name}.urdf").read_text())
    return where


@cache
def described(name, link, stated):
    """The robot, its target on this link if one is given."""
    path = robot_file() if name == "medrue" else EXAMPLES / f"{name}.yaml"
    text = (folder() / "ur10e.yaml" if name == "ur10e" else path).read_text()
    if name == "medrue":
        (folder() / "medrue.urdf").write_text((path.parent / "medrue.urdf").read_text())
    if link is not None or name == "ur10e":
        frame = link or "flange"
        text = re.sub(r"(?m)^  (\w+): \{frame: .*xyz.*\}$", rf"  \1: {{frame: {frame}, position: unknown}}", text)
    text = re.sub(r"(?m)^sigma: .*$", "", text) + (f"sigma: {SIGMA[name]}\n" if stated else "")
    (folder() / f"{name}_described.yaml").write_text(text)
    return calib.load(folder() / f"{name}_described.yaml")


@cache
def true_robot(name):
    """The robot as it is: with errors, a reflector beside its last axis, and a base somewhere."""
    robot, rng = described(name, None, True), np.random.default_rng(3)
    size = 0.3 if name == "ur10e" else 0.7  # of what its description expects
    values = {"base.x": 1.5, "base.y": -0.7, "base.rx": 0.02, "base.rz": 0.9}
    offset = {"x": 0.02, "y": 0.004, "z": 0.05}
    places = {f"{target}.{axis}": by for target in robot.target_names for axis, by in offset.items()}
    for parameter, free in zip(robot.parameters[: robot.n_origin_parameters], robot.is_free, strict=False):
        if free and not parameter.placement:
            values[parameter.name] = parameter.nominal_si + size * parameter.sigma_si * rng.standard_normal()
    known = {parameter.name for parameter in robot.parameters}
    return robot.with_parameters({key: value for key, value in (values | places).items() if key in known})


@cache
def measured(name):
    """Joint values of the true robot, (n, n_joints), and where its target was read, (n, 1, 3)."""
    robot, rng = true_robot(name), np.random.default_rng(4)
    if name in REACH:
        q = rng.uniform(*np.radians(REACH[name]), (POSES, 6))
    elif name == "medrue":
        q = target_workspace().q
        q = q[rng.permutation(len(q))[:POSES]]
    else:
        seen = calib.read_measurements(EXAMPLES / "five_bar_simulated.csv", described(name, None, True)).joints
        q = rng.uniform(seen.min(axis=0), seen.max(axis=0), (4 * POSES, 2))
        q = q[robot.close(q).ok]
        q = q[robot.singular_values(robot.assemble(q)) > 0.15][:POSES]
    points = robot.positions(q)
    return q, points + SIGMA[name] * rng.standard_normal(points.shape)


def fitted(case):
    """The fit of what was written down."""
    robot = described(case.name, case.link, case.stated)
    q, points = measured(case.name)
    written = q.copy()
    written[:, case.joint] *= case.scale
    closed = robot.close(written).ok
    data = calib.as_measurements(robot, written[closed], points[closed])
    held = np.arange(len(data)) % 4 == 3
    if not case.held_out:
        return calib.fit(robot, data, terms=case.terms)
    used, unused = (data.subset(np.flatnonzero(rows)) for rows in (~held, held))
    return calib.fit(robot, used, validation=unused, terms=case.terms)


def cases(wrong, settings=SETTINGS):
    """Every wrong robot in every setting, in random order."""
    every = [Case(*robot, *setting) for robot in wrong for setting in settings]
    return [every[k] for k in np.random.default_rng(0).permutation(len(every))]


def passed(some):
    """Those of the cases that get PASS, with the error that is claimed [m]."""
    result = []
    for case in some:
        try:
            verdict = fitted(case).verdict
        except CalibrationError:  # refused
            continue
        if verdict.grade == "PASS":
            result.append((case, verdict.claim.at_measured_poses.rms))
    return result


@pytest.fixture(scope="module", autouse=True)
def _ur10e(run_calib):
    run_calib("init", "--dh", EXAMPLES / "ur10e_dh.csv", "--out", "ur10e.yaml", cwd=folder())


@pytest.mark.quick(1)
@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("name", list(SIGMA))
def test_robots_that_are_as_described_pass(name, stated):
    fit = fitted(Case(name, stated=stated))
    assert fit.verdict.grade == "PASS", fit.verdict
    assert fit.verdict.claim.at_measured_poses.rms < 2.2 * SIGMA[name]  # sqrt(3), and what the fit adds


@pytest.mark.amount(1, 30)
def test_no_robot_passes_whose_joint_is_scaled(amount):
    joints = {"arm": 6, "ur10e": 6, "five_bar": 2, "medrue": 6}
    scaled = [(name, j, scale, None) for name, n in joints.items() for j in range(n) for scale in SCALES]
    assert passed(cases(scaled)[:amount]) == []


@pytest.mark.quick(0)
@pytest.mark.amount(1, 20)
def test_no_robot_passes_whose_target_is_described_on_another_link(amount):
    """But where that changes nothing: then the error is no more than noise."""
    wrong = [(name, 0, 1.0, link) for name, links in LINKS.items() for link in links]
    assert [case for case, rms in passed(cases(wrong)[:amount]) if rms > 2.2 * SIGMA[case.name]] == []


def test_a_scaled_joint_is_named_with_its_factor_where_origins_hide_it():
    """MedRUE's motor 2 turns 3 % less far than its values say: after the fit 0.2 mm are left, and new poses agree."""
    fit = fitted(Case("medrue", 1, 1.03, held_out=True))
    assert fit.verdict.claim.holds
    assert fit.verdict.claim.at_measured_poses.rms < 0.3e-3
    assert [reason.code for reason in fit.verdict.reasons if reason.grade != "PASS"] == ["joint_scaled"]
    factor = float(re.search(r"joint q2 ([\d.]+) times as far", str(fit.verdict))[1])
    assert factor == pytest.approx(1 / 1.03, abs=5e-3)


LAST_JOINTS = {
    "of the row before": lambda q: np.roll(q, 1),
    "of half a row before": lambda q: (q + np.roll(q, 1)) / 2,
    "degrees for radians": np.degrees,
    "without sign": np.abs,
}


@pytest.mark.quick(1)
@pytest.mark.parametrize("what", LAST_JOINTS)
def test_a_last_joint_whose_values_are_wrong_is_named_where_it_hardly_moves_the_target(what):
    """The target is 4 mm from its axis, and no noise is stated: a fit moves it onto the axis, and leaves a circle."""
    nominal, rng = described("ur10e", None, False), np.random.default_rng(7)
    q = rng.uniform(-1.0, 1.0, (70, 6)) * np.radians([150, 80, 120, 150, 150, 170])
    true = true_robot("ur10e").with_parameters({f"{nominal.target_names[0]}.{axis}": 3e-3 for axis in "xy"})
    points = true.positions(q) + 3e-5 * rng.standard_normal((70, 1, 3))
    wrong = q.copy()
    wrong[:, 5] = LAST_JOINTS[what](q[:, 5])
    for joints, grade in ((q, "PASS"), (wrong, "CHECK")):
        verdict = calib.fit(nominal, calib.as_measurements(nominal, joints, points)).verdict
        assert verdict.grade == grade, verdict
    assert f"joint {nominal.joint_names[5]} does not move as its values say" in str(verdict)


@pytest.mark.quick(1)
@pytest.mark.parametrize("stated", [True, False])
def test_a_target_on_the_link_before_its_own_is_named_with_its_joint(stated):
    """It sits 4 mm from the axis of the last joint, which the description lets it not move with."""
    real, link = true_robot("ur10e").with_parameters({"flange.x": 0.004, "flange.y": 0.0}), "link_5"
    robot, q = described("ur10e", link, stated), measured("ur10e")[0]
    points = real.positions(q) + 3e-5 * np.random.default_rng(4).standard_normal((POSES, 1, 3))
    fit = calib.fit(robot, calib.as_measurements(robot, q, points))
    assert fit.verdict.grade == "CHECK"
    said = re.search(r"flange moves with joint wrist_3_joint, as .* ([\d.]+) mm from where", str(fit.verdict))
    assert float(said[1]) == pytest.approx(4.0, abs=1.2)  # the axis is off as well


def fit_of_a_point_on(link, name, stated):
    """The fit of a robot whose target is described at its end, and in truth sits on a link before it."""
    (q, _), robot = measured(name), described(name, None, stated)
    T = true_robot(name).forward(q, link)
    points = T[:, :3, 3] + T[:, :3, :3] @ [0.02, 0.03, 0.05]
    points += SIGMA[name] * np.random.default_rng(4).standard_normal(points.shape)
    return calib.fit(robot, calib.as_measurements(robot, q, points[:, None]))


@pytest.mark.quick(1)
@pytest.mark.parametrize("stated", [True, False])
def test_axes_that_are_bent_through_a_target_on_a_link_before_them_are_no_pass(stated):
    """The fit is as good as the noise, and so are poses left out: only the distance of parameters shows it."""
    fit = fit_of_a_point_on("link_5", "ur10e", stated)
    assert fit.sigma < 2 * SIGMA["ur10e"]
    assert fit.verdict.grade == "CHECK", fit.verdict
    assert "check zero positions, units and the targets' links" in str(fit.verdict)


@pytest.mark.quick(1)
@pytest.mark.parametrize("stated", [True, False])
def test_a_joint_that_does_not_move_the_target_is_named_as_that(stated):
    """Its scale would be nothing, which no unit is."""
    fit = fit_of_a_point_on("link_5", "arm", stated)
    assert fit.verdict.grade == "FAIL"
    text = fit.verdict.reasons[0].text
    assert "the target does not move with joint_6, as if it sat on a link before it" in text
    assert "In the description" not in text  # no column corrects it

"""One robot described in several ways is one robot: names, order and axis signs decide nothing."""

import dataclasses
from dataclasses import dataclass

import numpy as np
import pytest

import calib
from calib.core.robots.joint_sampling import joint_samples
from calib.core.rows.frames import poses_around_home
from calib.exporting.gap import poses_near_home
from calib.matching.agreement import other_poses
from tests.project import EXAMPLES
from tests.urdf_trees import urdf_of

SIGMA = 4e-5


@dataclass(frozen=True)
class Link:
    """A moving joint of a chain: its origin in the link before, its axis, and where it is in the table."""

    name: str
    xyz: tuple[float, ...]
    rpy: tuple[float, ...]
    axis: tuple[float, ...]
    sign: float = 1.0
    split: bool = False


CHAIN = (
    Link("j1", (0.02, 0.01, 0.40), (0.1, -0.2, 0.3), (0.0, 0.0, 1.0)),
    Link("j2", (0.05, 0.00, 0.10), (0.0, 0.3, 0.0), (0.0, 1.0, 0.0)),
    Link("j3", (0.00, 0.03, 0.60), (0.2, 0.0, -0.4), (0.0, 1.0, 0.0)),
    Link("j4", (0.20, 0.00, 0.05), (0.0, 0.1, 0.5), (1.0, 0.0, 0.0)),
    Link("j5", (0.40, 0.02, 0.00), (-0.3, 0.0, 0.2), (0.0, 1.0, 0.0)),
    Link("j6", (0.10, 0.00, 0.02), (0.4, 0.2, 0.0), (1.0, 0.0, 0.0)),
)


def _urdf(chain, order):
    """The chain as a URDF whose joints stand in an order; a split joint has its translation in a fixed one."""
    joints, before = [], "world"
    for link in chain:
        own, xyz = [], link.xyz
        if link.split:
            own.append((f"fixed_{link.name}", "fixed", before, f"to_{link.name}", _element("origin", xyz=link.xyz)))
            before, xyz = f"to_{link.name}", (0.0, 0.0, 0.0)
        origin, axis = _element("origin", xyz=xyz, rpy=link.rpy), _element("axis", xyz=link.sign * np.array(link.axis))
        own.append((link.name, "revolute", before, f"after_{link.name}", origin, axis))
        joints.append(own)
        before = f"after_{link.name}"
    links = [f"after_{link.name}" for link in reversed(chain)]
    return urdf_of(*(joint for k in order for joint in joints[k]), links=links), before


def _element(tag, **numbers):
    """An element with attributes of numbers, all their digits."""
    return f"<{tag} " + " ".join(f'{key}="{" ".join(map(repr, map(float, n)))}"' for key, n in numbers.items()) + "/>"


def _measured(truth, q, rng):
    """Readings of a robot whose second joint is off on one side of the first: parameters differ from side to side."""
    off = q.copy()
    off[:, 1] += 8e-4 * (q[:, 0] > 0) * np.sin(q[:, 2])
    return truth.positions(off) + SIGMA * rng.standard_normal((len(q), 1, 3))


def _robot(folder, chain, order):
    folder.mkdir()
    urdf, last = _urdf(chain, order)
    names = [chain[k].name for k in order]
    (folder / "arm.urdf").write_text(urdf)
    free = [
        f"  - {{origin: {name}, components: [{components}], sigma: {sigma}}}\n"
        for name in names
        for components, sigma in (("x, y, z", "2 mm"), ("rx, ry, rz", "5 mrad"))
    ]
    (folder / "arm.yaml").write_text(
        f"urdf: arm.urdf\nname_mot: [{', '.join(names)}]\nbase: {{frame: world, pose: unknown}}\n"
        f"targets: {{ball: {{frame: {last}, xyz: [50 mm, 20 mm, 100 mm]}}}}\nsigma: 0.04 mm\nparametrisation:\n"
        + "".join(free)
    )
    return calib.load(folder / "arm.yaml")


def _in_another_way(link, what, k):
    roll, pitch, yaw = link.rpy
    changes = {
        "renamed": {"name": f"{'zyxwvu'[k]}{k}"},
        "reversed": {"sign": -1.0 if k in (0, 2, 3) else 1.0},
        "other angles": {"rpy": (roll + np.pi, np.pi - pitch, yaw + np.pi)},
        "split": {"split": k in (1, 4)},
        "order": {},
    }
    return dataclasses.replace(link, **changes[what])


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """Poses, and what was read there."""
    rng = np.random.default_rng(4)
    q = rng.uniform(-1.4, 1.4, (117, 6))  # 117: no halves of equal size
    truth = _robot(tmp_path_factory.mktemp("truth") / "arm", CHAIN, range(6))
    return q, _measured(truth, q, rng), rng.uniform(-1.4, 1.4, (20, 6))


def _fitted(folder, told, chain, order):
    """A fit of the chain described in one way, and what it says in words that names do not change."""
    q, positions, elsewhere = told
    signs = np.array([link.sign for link in chain])
    robot = _robot(folder, chain, order)
    fit = calib.fit(robot, calib.as_measurements(robot, (q * signs)[:, list(order)], positions))
    at = fit.predict((elsewhere * signs)[:, list(order)])
    by_name = {link.name: f"j{k + 1}" for k, link in enumerate(chain)}
    std = {
        (by_name[name.split(".")[0]], name.split(".")[1]): fit.parameters[name].std_si
        for name in fit.free_names
        if name.split(".")[0] in by_name
    }
    return fit, at, std


@pytest.fixture(scope="module")
def first(told, tmp_path_factory):
    return _fitted(tmp_path_factory.mktemp("first") / "arm", told, CHAIN, range(6))


@pytest.mark.quick(1)
@pytest.mark.parametrize("ways", [("order",), ("renamed",), ("reversed",), ("other angles",), ("split",),
                                  ("renamed", "reversed", "split")])  # fmt: skip
def test_a_fit_says_the_same_of_a_robot_described_in_another_way(told, first, tmp_path, ways):
    chain, order = list(CHAIN), range(6)
    for what in ways:
        chain = [_in_another_way(link, what, k) for k, link in enumerate(chain)]
    if ways[0] in ("order", "renamed"):
        order = (5, 2, 0, 3, 4, 1)
    fit, at, std = _fitted(tmp_path / "arm", told, tuple(chain), order)
    same, predicted, same_std = first
    assert same.interval_factor > 1.0
    assert fit.interval_factor == pytest.approx(same.interval_factor, rel=1e-6)
    assert fit.sigma == pytest.approx(same.sigma, rel=1e-6)
    np.testing.assert_allclose(at.positions, predicted.positions, atol=1e-9)
    np.testing.assert_allclose(at.std, predicted.std, rtol=1e-5)
    codes, same_codes = ([reason.code for reason in one.verdict.reasons] for one in (fit, same))
    assert (fit.verdict.grade, codes) == (same.verdict.grade, same_codes)
    for number in ("rms", "limit95"):
        claimed, same_claimed = (getattr(one.verdict.claim.at_measured_poses, number) for one in (fit, same))
        assert claimed == pytest.approx(same_claimed, rel=1e-6)
    assert fit.verdict.claim.rms == pytest.approx(same.verdict.claim.rms, rel=1e-5)
    if "split" not in ways:  # directions of an origin are those of the link before
        np.testing.assert_allclose([std[key] for key in sorted(std)], [same_std[key] for key in sorted(std)], rtol=1e-5)


@pytest.mark.quick(0)
@pytest.mark.parametrize(
    "ways",
    [("renamed", "reversed", "split"), pytest.param(("reversed", "other angles"), marks=pytest.mark.amount(0, 1))],
)
def test_searches_start_and_end_at_the_same_places(tmp_path, ways):
    chain, order = list(CHAIN), (5, 2, 0, 3, 4, 1)
    for what in ways:
        chain = [_in_another_way(link, what, k) for k, link in enumerate(chain)]
    first, other = _robot(tmp_path / "first", CHAIN, range(6)), _robot(tmp_path / "other", tuple(chain), order)
    signs = np.array([link.sign for link in chain])

    def as_first(q):
        return q[:, np.argsort(order)] * signs

    halves = joint_samples(first.mode, 50) - 0.5, joint_samples(other.mode, 50) - 0.5
    np.testing.assert_allclose(as_first(halves[1]), halves[0], atol=1e-12)
    for places in (poses_around_home, poses_near_home, other_poses):
        np.testing.assert_allclose(as_first(places(other)), places(first), atol=1e-9)
    rng = np.random.default_rng(2)
    poses = np.asarray(first.forward(rng.uniform(-2.5, 2.5, (30, 6)), "ball"))
    solutions = calib.solve(first, poses), calib.solve(other, poses)
    np.testing.assert_array_equal(solutions[1].ok, solutions[0].ok)
    ok = solutions[0].ok
    assert ok.sum() > 25
    np.testing.assert_allclose(as_first(solutions[1].q)[ok], solutions[0].q[ok], atol=1e-6)


def test_searches_of_a_robot_with_loops_start_at_the_same_places(tmp_path):
    first = calib.load(EXAMPLES / "five_bar.yaml")
    names = list(first.joint_names)
    text = (EXAMPLES / "five_bar.yaml").read_text()
    assert f"[{', '.join(names)}]" in text
    (tmp_path / "five_bar.urdf").write_text((EXAMPLES / "five_bar.urdf").read_text())
    (tmp_path / "other.yaml").write_text(text.replace(f"[{', '.join(names)}]", f"[{', '.join(names[::-1])}]"))
    other = calib.load(tmp_path / "other.yaml")
    np.testing.assert_allclose(joint_samples(other.mode, 20)[:, ::-1], joint_samples(first.mode, 20), atol=1e-12)

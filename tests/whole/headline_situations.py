"""What commands say of small robots: a situation that makes each headline true, and the same without its cause.

Measurements are simulated. Numbers in the sentences are computed again here, from positions of the robots alone.
"""

from functools import cached_property
from pathlib import Path

import numpy as np

import calib
from calib.core.data.in_memory import as_poses
from calib.core.judging.acceptance import verify
from calib.core.judging.repeatability import iso_figures
from calib.core.results import acceptance_text
from calib.planning import assessment_text, selection_text
from tests.six_axis_arm import YAML as SIX
from tests.six_axis_arm import write_six_axis
from tests.small_robots import ARM_YAML, write_arm, write_parallelogram

SIGMA = 3e-5
FEW_FREE = (
    "  - {origin: slide, components: [ry], sigma: 5 mrad}\n"
    "  - {origin: wrist, components: [x], sigma: 2 mm}\n"
    "  - {origin: flange, components: [z], sigma: 2 mm}\n"
)
"""Parameters of the small arm that positions of its tip tell apart."""


def on_one_line(text: str) -> str:
    """The text as it reads, whatever was wrapped."""
    return " ".join(text.split())


def value(robot, name):
    return float(robot.values[[p.name for p in robot.parameters].index(name)])


def joints(n, seed):
    """Joint values of the small arm."""
    return np.random.default_rng(seed).uniform([-2, 0.1, -1.5], [2, 0.9, 1.5], (n, 3))


def measured(robot, q, seed, sigma=SIGMA, names=None):
    noise = sigma * np.random.default_rng(seed).standard_normal((len(q), 1, 3))
    return calib.as_measurements(robot, q, robot.positions(q) + noise, names)


def derivative(robot, q, names):
    """Of positions by parameters, by central differences, (3 n, n_names)."""
    columns = []
    for name in names:
        more, less = (robot.with_parameters({name: value(robot, name) + step}) for step in (1e-6, -1e-6))
        columns.append((more.positions(q) - less.positions(q)).ravel() / 2e-6)
    return np.stack(columns, axis=1)


def rms(errors):
    """Root mean square length of (3 n) errors."""
    return float(np.sqrt(np.sum(np.square(errors)) / (np.size(errors) / 3)))


class Commands:
    """Robots and results that several situations share; each is made when it is first asked for."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def new(self) -> Path:
        folder = self.folder / str(len(list(self.folder.iterdir())))
        folder.mkdir()
        return folder

    def arm(self, entries: str = "", more: str = "", base: str = "unknown") -> calib.Robot:
        """The small arm, with all components free if none are given."""
        head, all_components = ARM_YAML.split("parametrisation:\n")
        yaml = f"{head}parametrisation:\n{entries or all_components}"
        return calib.load(write_arm(self.new(), yaml.replace("frame: ground", f"frame: ground, pose: {base}") + more))

    @cached_property
    def robot(self):
        """The small arm, its noise stated."""
        return self.arm(more="sigma: 0.03 mm\n")

    @cached_property
    def truth(self):
        rng = np.random.default_rng(1)
        drawn = {
            p.name: p.nominal_si + 0.5 * p.sigma_si * rng.standard_normal()
            for p in self.robot.parameters
            if not p.placement
        }
        return self.robot.with_parameters(drawn | {"base.x": 0.3, "base.rz": 0.2})

    def changed(self, **changes):
        """The true robot after some parameters changed; `wrist_x` is `wrist.x`."""
        names = {name.replace("_", "."): size for name, size in changes.items()}
        return self.truth.with_parameters({name: value(self.truth, name) + size for name, size in names.items()})

    @cached_property
    def fit(self):
        return calib.fit(self.robot, measured(self.truth, joints(60, 1), 1))

    @cached_property
    def in_a_corner(self):
        """A fit of poses in a corner, which leaves directions open."""
        rng = np.random.default_rng(4)
        q = rng.uniform([-0.3, 0.4, -0.3], [0.3, 0.6, 0.3], (40, 3))
        return calib.fit(self.robot, calib.as_measurements(self.truth, q, self.truth.positions(q) + noise_of(rng, 40)))

    @cached_property
    def verified(self):
        """By name: what new measurements say."""
        q, slipped = joints(25, 2), measured(self.truth, joints(25, 7), 7)
        points = slipped.points(self.truth).copy()
        points[7] += [0, 0.01, 0]
        often = np.tile(joints(3, 4), (30, 1))
        names = [f"P{k % 3}" for k in range(90)]
        rng = np.random.default_rng(54)
        elsewhere = rng.uniform([-2, 0.1, -1.5], [2, 0.9, 1.5], (25, 3))
        stretched = self.changed(flange_z=3e-4)
        hidden = calib.as_measurements(stretched, elsewhere, stretched.positions(elsewhere) + noise_of(rng, 25))
        return {
            "agrees": verify(self.fit, measured(self.truth, q, 2)),
            "quiet": verify(self.fit, measured(self.truth, q, 2, 0.3 * SIGMA)),
            "alone": verify(self.fit, measured(self.changed(flange_z=3e-4), q, 3)),
            "alike": verify(self.fit, measured(self.changed(slide_x=3e-4), q, 3)),
            "two": verify(self.fit, measured(self.changed(slide_x=3e-4, flange_z=4e-4), q, 3)),
            "slip": verify(self.fit, calib.as_measurements(self.truth, slipped, points)),
            "often": verify(self.fit, measured(self.truth, often, 5, SIGMA, names)),
            "same setup": verify(self.fit, measured(self.truth, often, 5, SIGMA, names), same_setup=True),
            "hidden": verify(self.in_a_corner, hidden),
            "seen": verify(self.fit, hidden),
            "faint": verify(self.fit, measured(self.changed(flange_z=3e-5), joints(100, 2), 3, 0.8 * SIGMA)),
        }

    @cached_property
    def verify_texts(self):
        texts = {}
        for name, acceptance in self.verified.items():
            figures, missing = iso_figures(acceptance.errors, np.random.default_rng(0))
            texts[name] = on_one_line(acceptance_text.text_report(acceptance, figures, missing))
        return texts

    @cached_property
    def checked(self):
        """By name: what poses determine."""
        (few, _), priors = self.few_free, self.robot
        known = self.arm(FEW_FREE, "priors: false\n", "known")
        still = joints(20, 3) * [1, 0, 0] + [0, 0.3, 0.2]
        loop, camera = calib.load(write_parallelogram(self.new())), self.from_unknown_place
        crank = np.linspace(0.6, 2.4, 30)
        return {
            "determined": calib.check(known, joints(20, 3)),
            "base": calib.check(few, joints(20, 3)),
            "two positions": calib.check(few, joints(20, 3), task=joints(2, 4)),
            "still": calib.check(few, still, task=joints(20, 3)),
            "priors": calib.check(priors, joints(3, 3), task=joints(20, 4), sigma=1e-9),
            "singular": calib.check(loop, np.append(crank, 0.004)[:, None]),
            "regular": calib.check(loop, crank[:, None]),
            "unknown place": calib.check(camera, np.random.default_rng(0).uniform(-1.5, 1.5, (30, 6))),
        }

    @cached_property
    def from_unknown_place(self):
        """A six-axis arm whose second ball is read only from a place that is not known."""
        targets = "  ball: {frame: l6, xyz: [50 mm, 20 mm, 100 mm]}\n"
        instruments = (
            "instruments:\n  ball: {kind: position, sigma: 0.03 mm}\n"
            "  wire: {kind: distance, target: other, sigma: 0.1 mm,"
            " end: {frame: l0, xyz: [1, 0.5, 0], position: unknown}}\n"
        )
        yaml = SIX.replace(targets, f"{targets}  other: {{frame: l6, xyz: [0, -40 mm, 90 mm]}}\n{instruments}")
        return calib.load(write_six_axis(self.new(), yaml + "  - {origin: j2, components: [x], sigma: 2 mm}\n"))

    @cached_property
    def check_texts(self):
        return {
            name: on_one_line(assessment_text.text_report(assessment, "poses.csv"))
            for name, assessment in self.checked.items()
        }

    @cached_property
    def selections(self):
        """By name: a choice of poses, and its candidates."""
        robot, (stated, _), bare = self.robot, self.few_free, self.arm(FEW_FREE)
        nine, sixty = as_poses(stated, joints(9, 1)), as_poses(stated, joints(60, 2))
        still = as_poses(stated, joints(20, 3) * [1, 0, 0] + [0, 0.3, 0.2])
        done = np.vstack([nine.joints[:2], joints(5, 5)])
        return {
            "nine": (nine, calib.select(stated, nine, 5)),
            "no bound": (nine, calib.select(stated, nine, 5, "O2")),
            "all": (nine, calib.select(stated, nine, 9, "O2")),
            "starts": (nine, calib.select(stated, nine, 5, "O2", starts=5)),
            "apart": (sixty, calib.select(stated, sixty, 8, "task", minimum_distance=0.3)),
            "still": (still, calib.select(stated, still, 8)),
            "priors": (nine, calib.select(robot, nine, 5)),
            "measured": (nine, calib.select(robot, nine, 3, measured=as_poses(robot, joints(4, 5)))),
            "again": (nine, calib.select(bare, nine, 3, measured=as_poses(bare, done))),
        }

    @cached_property
    def select_texts(self):
        return {
            name: on_one_line(selection_text.text_report(selection, poses))
            for name, (poses, selection) in self.selections.items()
        }

    @cached_property
    def few_free(self):
        """The small arm with three parameters and its base, all without priors, and what it is in truth."""
        robot = self.arm(FEW_FREE, "priors: false\nsigma: 0.03 mm\n")
        return robot, robot.with_parameters({"slide.ry": 2e-3, "wrist.x": 0.126, "flange.z": 0.099, "base.x": 0.3})

    @cached_property
    def results(self):
        """By name: fits of robots to compare."""
        (robot, truth), places = self.few_free, self.arm(" []\n", "priors: false\n")
        longer = truth.with_parameters({"flange.z": value(truth, "flange.z") + 2e-4})
        elsewhere = truth.with_parameters({"base.x": 0.35, "base.rz": 0.1})
        fits = {
            "first": calib.fit(robot, measured(truth, joints(40, 1), 1)),
            "again": calib.fit(robot, measured(truth, joints(40, 2), 2), folds=4),
            "longer": calib.fit(robot, measured(longer, joints(40, 3), 3)),
            "elsewhere": calib.fit(robot, measured(elsewhere, joints(40, 4), 4)),
            "held": calib.fit(robot.fix("wrist.x"), measured(truth, joints(40, 5), 5), validation=0.25),
            "placed": calib.fit(places, measured(places, joints(20, 1), 1)),
            "moved": calib.fit(places, measured(places.with_parameters({"base.x": 0.05}), joints(20, 2), 2)),
            "there": calib.fit(places, measured(places, joints(20, 3), 3)),
            "arm": self.fit,
            "other": self.unlike,
        }
        folder = self.new()
        for name, fit in fits.items():
            fit.save(folder / name, pages=False)
        return fits, folder

    @cached_property
    def unlike(self):
        """A fit of a robot that differs a little in many parameters, as the fit of the arm is known."""
        known = self.fit.covariance
        step = np.random.default_rng(16).standard_normal(len(known.names))
        step = np.linalg.cholesky(known.values) @ step * 12 / np.linalg.norm(step)
        changes = {name: size for name, size in zip(known.names, step, strict=True) if not name.startswith("base")}
        other = self.truth.with_parameters({name: value(self.truth, name) + size for name, size in changes.items()})
        return calib.fit(self.robot, measured(other, joints(60, 4), 4))

    @cached_property
    def comparisons(self):
        """By name: two results side by side."""
        fits, folder = self.results
        pairs = {f"first and {name}": ("first", name) for name in ("again", "longer", "elsewhere", "held")}
        pairs |= {f"placed and {name}": ("placed", name) for name in ("moved", "there")}
        found = {name: calib.compare(*(folder / each for each in pair)) for name, pair in pairs.items()}
        found["same readings"] = calib.compare(fits["first"], fits["first"])
        found["arm and other"] = calib.compare(folder / "arm", folder / "other")
        return found

    @cached_property
    def compare_texts(self):
        texts = {name: on_one_line(comparison.report()) for name, comparison in self.comparisons.items()}
        conclusions = {f"{name}, page": c.conclusion() for name, c in self.comparisons.items()}
        return texts | {name: on_one_line(text) for name, text in conclusions.items()}

    @cached_property
    def watched(self):
        """By name: what is known after some poses."""
        robot, truth = self.few_free
        candidates = as_poses(robot, joints(30, 8))
        exact, noisy = measured(truth, joints(60, 9), 9), measured(truth, joints(60, 9), 9, 2e-4)
        bare = self.arm(FEW_FREE, "priors: false\n")
        wire = self.arm(
            FEW_FREE,
            "priors: false\ninstruments:\n  wire: {kind: distance, target: tip, sigma: 0.03 mm, end: {frame: ground,"
            " xyz: [1, 0.5, 0]}}\n  beam: {kind: distance, target: tip, sigma: 0.03 mm, end: {frame: ground, xyz: [0,"
            " -1, 0.3]}}\n",
            "known",
        )
        lengths = calib.simulate(wire, joints(40, 9), seed=9)

        def after(robot, goal, *updates, poses=candidates):
            watch = calib.Watch(robot, goal, candidates=as_poses(robot, poses.joints))
            for update in updates:
                told = watch.update(update)
            return told

        return {
            "nothing": after(robot, 1e-4, None),
            "three": after(robot, 1e-4, exact[:3]),
            "twelve": after(robot, 1e-5, exact[:12]),
            "met": after(robot, 2e-4, exact[:40], exact),
            "close": after(robot, 5.5e-5, exact[:40], exact),
            "bent": after(robot, 1.5e-4, *(bent(truth, joints(60, 9), 9)[:n] for n in (40, 60))),
            "noisy": after(bare, 2.5e-4, *(noisy[:n] for n in (40, 60))),
            "all measured": after(robot, 1e-5, exact[:12], poses=exact[:12]),
            "wire": after(wire, 1e-5, lengths),
        }

    @cached_property
    def watch_texts(self):
        return {name: on_one_line(progress.report()) for name, progress in self.watched.items()}


def noise_of(rng, n):
    return SIGMA * rng.standard_normal((n, 1, 3))


def bent(robot, q, seed):
    """Measurements of a robot whose slide is off by a wave that no parameter has."""
    off = q.copy()
    off[:, 1] += 3e-4 * np.sin(9 * q[:, 0])
    return calib.as_measurements(robot, q, measured(robot, off, seed).points(robot))

"""For each reason of the verdict, a fit that deserves it, and the same set-up without its cause.

Measurements are simulated, and go through `calib.fit`. Where the sentence has a number, it is computed again from what
was simulated: a pattern whose groups are the numbers, and what they should be.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import calib
from calib.core.data.measurements import with_points
from calib.core.judging.reasons import Code, Reason
from calib.core.judging.rules_model import check_solution
from calib.core.robots.terms.terms import parse_terms
from tests.core.calibrating import test_fit_files as warm
from tests.core.instruments import test_kind_pixel as pixel
from tests.core.instruments.test_kind_pose import YAML as POSES
from tests.core.judging import test_misread_numbers as misread
from tests.fleets import fleet_figures
from tests.project import EXAMPLES
from tests.six_axis_arm import FREE, NO_PRIORS, YAML, joints, measurements, noisy, write_six_axis
from tests.small_robots import edited_five_bar, write_parallelogram
from tests.urdf_trees import urdf_of

SIGMA = 4e-5
ALONE = "  - {origin: j6, components: [y, z], sigma: 2 mm}\n  - {origin: ball, components: [x, y, z], sigma: 2 mm}\n"
"""What only a pose that moves joint 6 tells apart."""


@dataclass(frozen=True)
class Situation:
    """A fit with a reason, the same without its cause, and the numbers of the sentence.

    Attributes:
        there: The fit that deserves the reason.
        gone: The same without the cause.
        says: Pattern of the sentence; its groups are numbers.
        numbers: What they should be, found by other means.
        within: Relative tolerance: digits shown, or the chance of noise.
        rule: What gives the reason by itself, where the fit is none that a verdict can be given on.
    """

    there: calib.Calibration
    gone: calib.Calibration
    says: str
    numbers: tuple[float, ...] = ()
    within: float = 0.01
    rule: Callable[[calib.Calibration], Iterable[Reason]] | None = None

    def reasons(self, fit):
        """What is said of one of the two fits."""
        return fit.verdict.reasons if self.rule is None else tuple(self.rule(fit))


class Shop:
    """Robots and fits that several situations share; each is made when it is first asked for."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.known: dict[Code, Situation] = {}

    def situation(self, code: Code) -> Situation:
        """What deserves this reason."""
        if code not in self.known:
            self.known[code] = SITUATIONS[code](self)
        return self.known[code]

    def new(self) -> Path:
        """An empty folder."""
        folder = self.folder / str(len(list(self.folder.iterdir())))
        folder.mkdir()
        return folder

    def robot(self, yaml: str = YAML + FREE) -> calib.Robot:
        """The six-axis arm with this description."""
        return calib.load(write_six_axis(self.new(), yaml))

    @cached_property
    def prior(self) -> calib.Robot:
        """The arm with priors on all of its components."""
        return self.robot()

    @cached_property
    def arm(self) -> calib.Robot:
        """The arm without priors."""
        return self.robot(NO_PRIORS + YAML + FREE)

    def off(self, robot: calib.Robot, by: float = 0.5) -> calib.Robot:
        """The same robot with errors of half its parameters' sigma."""
        sigma = np.array([parameter.sigma_si for parameter in robot.parameters])
        step = np.where(robot.is_free, sigma, 0.0) * np.random.default_rng(6).standard_normal(len(sigma))
        return robot.with_parameters(robot.values + by * step)

    @cached_property
    def truth(self) -> calib.Robot:
        """The arm without priors, with errors."""
        return self.off(self.arm)

    @cached_property
    def used(self):
        """80 poses of it."""
        return noisy(self.truth, joints(80), SIGMA, 1)

    @cached_property
    def other(self):
        """30 others."""
        return noisy(self.truth, joints(30, 5), SIGMA, 2)

    @cached_property
    def good(self) -> calib.Calibration:
        """A fit to which nothing is to be said."""
        return calib.fit(self.arm, self.used, sigma=SIGMA, validation=self.other)

    @cached_property
    def good_prior(self) -> calib.Calibration:
        """The same of the arm with priors, whose robot is nominal."""
        return calib.fit(self.prior, noisy(self.prior, joints(80), SIGMA, 1), sigma=SIGMA)

    @cached_property
    def small_gain(self) -> calib.Calibration:
        """A fit of the example arm whose joint 2 turns by 2 per mille too far, twice as much as is usual."""
        return fit_with_term("gain", "joint_2.gain", 2.0)


def rms(errors) -> float:
    """Root mean square length in mm."""
    return 1e3 * float(np.sqrt(np.mean(np.sum(np.reshape(errors, (-1, 3)) ** 2, axis=1))))


WORSE = r"makes the robot worse on the validation poses.* RMS ([\d.]+) mm after, ([\d.]+) mm before"
SITUATIONS: dict[Code, Callable[[Shop], Situation]] = {}
GRADES: dict[Code, str] = {}
"""Of the whole verdict, where a situation states it; PASS: the reason is a remark, since unused poses prove the fit."""


def situation(code: Code, grade: str = ""):
    """Enter a situation into the table."""

    def enter(make: Callable[[Shop], Situation]) -> Callable[[Shop], Situation]:
        assert code not in SITUATIONS
        SITUATIONS[code] = make
        GRADES.update({code: grade} if grade else {})
        return make

    return enter


@situation(Code.BASE_ELSEWHERE, "CHECK")
def _(shop):
    data = shop.good_prior.identification.data
    moved = data.points(shop.prior) @ Rotation.from_euler("x", 1, degrees=True).as_matrix().T + [0.02, -0.02, 0.01]
    there = calib.fit(shop.prior, with_points(shop.prior, data, moved))
    away = rms(moved[:, 0] - shop.prior.positions(joints(80))[:, 0])
    says = r"measurements \(RMS ([\d.]+) mm; .* xyz: \[([\d.-]+) mm, ([\d.-]+) mm, ([\d.-]+) mm\], rpy: \[([\d.]+)"
    return Situation(there, shop.good_prior, says, (away, 20.0, -20.0, 10.0, 1.0))


@situation(Code.TARGET_ELSEWHERE)
def _(shop):
    """The ball sits 150 mm farther along x and 20 mm along z of its link than the description has it."""
    data, section = shop.good_prior.identification.data, shop.prior.description.targets["ball"]
    away = np.array([0.15, 0.0, 0.02])
    moved = data.points(shop.prior) + (shop.prior.forward(joints(80), section.frame)[:, :3, :3] @ away)[:, None]
    there = calib.fit(shop.prior, with_points(shop.prior, data, moved))
    says = r"ball: set position: unknown, or xyz: \[([\d.-]+) mm, ([\d.-]+) mm, ([\d.-]+) mm\]"
    return Situation(there, shop.good_prior, says, tuple(1e3 * (np.array(section.xyz) + away)), 0.05)


@situation(Code.LIKELY_MISTAKE, "FAIL")
def _(shop):
    data = shop.good_prior.identification.data
    q = data.joints.copy()
    q[:, 2] *= -1
    points = data.points(shop.prior)
    there = calib.fit(shop.prior, measurements(shop.prior, q, points))
    wrong, right = (rms(shop.prior.positions(values) - points) for values in (q, joints(80)))
    says = r"joint j3 has the wrong sign.* the nominal robot fits (\d+) times better"
    return Situation(there, shop.good_prior, says, (wrong / right,), 0.3)


@situation(Code.NOT_CONVERGED)
def _(shop):
    nominal = calib.load(EXAMPLES / "five_bar.yaml")
    truth, q = nominal.with_parameters({"right_end.x": 0.297}), nominal.sample(10, seed=1)
    elbows = [robot.close(q).passive[:, nominal.mechanism.passive.index("right_elbow")] for robot in (nominal, truth)]
    limit = (elbows[1].max() + elbows[0].max()) / 2
    narrow = edited_five_bar(shop.new(), ('lower="0" upper="3"', f'lower="0" upper="{limit}"'))
    data = calib.simulate(truth, q, seed=2)
    return Situation(
        calib.fit(narrow, data), calib.fit(nominal, data), "passive joint right_elbow is at its limit in the URDF"
    )


@situation(Code.NOT_ASSEMBLED)
def _(shop):
    """No data lead there, since a fit closes the loops at each step: a link that was found 5 m long stands for it."""
    robot = calib.load(write_parallelogram(shop.new()))
    fit = calib.fit(robot, calib.simulate(robot, robot.sample(30, seed=1), sigma=SIGMA, seed=2))
    torn = replace(fit, robot=fit.robot.with_parameters({"c.x": 5.0}))
    return Situation(torn, fit, "cannot be assembled from its home configuration", rule=check_solution)


@situation(Code.WORSE_ON_VALIDATION, "FAIL")
def _(shop):
    corner = joints(40) * 0.05
    elsewhere = noisy(shop.arm, joints(40, 5), SIGMA, 2)
    there = calib.fit(shop.arm, noisy(shop.arm, corner, SIGMA, 1), validation=elsewhere)
    points = elsewhere.points(shop.arm)
    after, before = (rms(robot.positions(joints(40, 5)) - points) for robot in (there.robot, shop.arm))
    return Situation(there, shop.good, WORSE, (after, before))


@situation(Code.VALIDATION, "CHECK")
def _(shop):
    there = calib.fit(shop.arm, shop.used, validation=noisy(shop.truth, joints(30, 5), 3 * SIGMA, 2))
    off = rms(there.validation.data.points(shop.arm) - there.robot.positions(joints(30, 5)))
    return Situation(there, shop.good, r"([\d.]+) times as far off as claimed \(([\d.]+) mm RMS", (3.0, off), 0.15)


@situation(Code.RESIDUALS_GREW)
def _(shop):
    """Least squares make no sum larger: errors twice those of the nominal robot stand for a fit that does."""
    errors = shop.good.identification
    doubled = replace(errors, after={name: 2.0 * values for name, values in errors.before.items()})
    worse = replace(shop.good, identification=doubled)
    return Situation(worse, shop.good, r"are ([\d.]+) times those of the nominal robot", (2.0,))


@situation(Code.INSTRUMENTS_DISAGREE)
def _(shop):
    """A ball bar measured another robot, the nominal one; the tracker, which is better, wins."""
    yaml = f"{YAML}{FREE}instruments:\n  ball: {{kind: position, sigma: 0.02 mm}}\n"
    yaml += "  bar: {kind: distance, target: ball, sigma: 0.2 mm, end: {frame: l0, xyz: [1, 0.5, 0]}}\n"
    arm = shop.robot(yaml)
    q, true, fits = joints(80), shop.off(arm), []
    for barred in (arm, true):
        rng = np.random.default_rng(2)
        points = true.positions(q)[:, 0] + 2e-5 * rng.standard_normal((80, 3))
        lengths = np.linalg.norm(barred.positions(q)[:, 0] - [1, 0.5, 0], axis=1) + 2e-4 * rng.standard_normal(80)
        fits.append(calib.fit(arm, calib.as_measurements(arm, q, {"ball": points, "bar": lengths[:, None]})))
        if barred is arm:
            far = np.linalg.norm(fits[0].robot.positions(q)[:, 0] - [1, 0.5, 0], axis=1) - lengths
    after = 1e3 * np.sqrt(np.mean(far**2))
    return Situation(*fits, r"bar, distance, fit worse than before \(([\d.]+) mm RMS", (after,))


@situation(Code.FRAME_MOVED)
def _(shop):
    points = shop.other.points(shop.arm)
    turn, shift = Rotation.from_euler("z", 1e-3).as_matrix(), np.array([0, 0, 3e-3])
    there = calib.fit(shop.arm, shop.used, validation=with_points(shop.arm, shop.other, points @ turn.T + shift))
    centre = points.reshape(-1, 3).mean(axis=0)
    moved = 1e3 * np.linalg.norm(turn @ centre + shift - centre)
    return Situation(there, shop.good, r"by ([\d.]+) mm and ([\d.]+) deg", (moved, np.degrees(1e-3)), 0.04)


@situation(Code.NOTHING_TO_CORRECT)
def _(shop):
    data, other = noisy(shop.arm, joints(80), SIGMA, 1), noisy(shop.arm, joints(30, 5), SIGMA, 2)
    there = calib.fit(shop.arm, data, sigma=SIGMA, validation=other)
    after, before = (rms(other.points(shop.arm) - robot.positions(joints(30, 5))) for robot in (there.robot, shop.arm))
    return Situation(there, shop.good, r"RMS ([\d.]+) mm after, ([\d.]+) mm before", (after, before))


@situation(Code.NO_GAIN)
def _(shop):
    """Joint 2 stood 10 urad lower under the load of the poses used; the others were measured without it."""
    robot, fits = shop.robot(YAML + "  - {origin: j2, components: [ry], sigma: 5 mrad}\n"), []
    lower = robot.with_parameters({"j2.ry": 1e-5})
    used = noisy(lower, joints(80), SIGMA, 1)
    for other in (robot, lower):
        fits.append(calib.fit(robot, used, sigma=SIGMA, validation=noisy(other, joints(5, 5), SIGMA, 2)))
    points = fits[0].validation.data.points(robot)
    after, before = (rms(points - other.positions(joints(5, 5))) for other in (fits[0].robot, robot))
    return Situation(*fits, r"RMS ([\d.]+) mm after, ([\d.]+) mm before", (after, before))


@situation(Code.FILE_WITHHELD)
def _(shop):
    robot, used, cold = warm.warm_and_cold(shop.new(), warm.true_tip_of(shop.prior))
    held = used.subset(np.arange(40, 60))
    there = calib.fit(robot, used.subset(np.arange(40)), validation=cold)
    return Situation(there, calib.fit(robot, used.subset(np.arange(40)), validation=held), "are not written: ")


@situation(Code.FILE_HOLDS_LESS)
def _(shop):
    tip, gains = warm.true_tip_of(shop.prior), shop.robot(YAML + FREE + "  - {joint: all, term: gain, sigma: 0.01}\n")
    used, other = (warm.measured(gains, tip, n, seed) for n, seed in ((60, 1), (40, 2)))
    there, gone = (calib.fit(robot, used, validation=other) for robot in (gains, shop.prior))
    nominal, whole = (rms(robot.positions(other.joints) - other.points(gains)) for robot in (shop.prior, there.robot))
    return Situation(there, gone, r"Nominal robot: ([\d.]+) mm.* whole model: ([\d.]+) mm", (nominal, whole))


@situation(Code.SYSTEMATIC)
def _(shop):
    """Joint 3 stands 0.5 mrad sin(3 q) off, a wave that no origin has."""
    off = joints(80).copy()
    off[:, 2] += 5e-4 * np.sin(3 * off[:, 2])
    there = calib.fit(shop.arm, measurements(shop.arm, joints(80), noisy(shop.truth, off, SIGMA, 1).points(shop.arm)))
    return Situation(there, shop.good, r"a systematic error remains: .*j3")


@situation(Code.OTHER_MINIMUM)
def _(shop):
    """Distances from two points near the plane of an arm hardly tell on which side of the plane its ball is."""
    fits = []
    for z in (4e-4, 0.3):
        folder, up = shop.new(), '<axis xyz="0 0 1"/>'
        elbow = ("j2", "revolute", "b", "c", f'<origin xyz="0.4 0 0"/>{up}')
        (folder / "r.urdf").write_text(urdf_of(("j1", "revolute", "a", "b", up), elbow))
        (folder / "r.yaml").write_text(
            "urdf: r.urdf\nname_mot: [j1, j2]\nbase: {frame: a}\npriors: false\n"
            "targets: {ball: {frame: c, xyz: [300 mm, 0 mm, 20 mm]}}\n"
            "instruments:\n  bar: {kind: distance, target: ball, end: {frame: a, xyz: [0.8, 0.3, 0]}}\n"
            f"  rod: {{kind: distance, target: ball, end: {{frame: a, xyz: [-0.2, 0.8, {z}]}}}}\n"
            "parametrisation: [{origin: ball, components: [z], sigma: 40 mm}]\n"
        )
        robot, rng = calib.load(folder / "r.yaml"), np.random.default_rng(3)
        q = rng.uniform(-2.5, 2.5, (40, 2))
        ends = np.array([[0.8, 0.3, 0.0], [-0.2, 0.8, z]])
        lengths = np.linalg.norm(robot.positions(q) - ends, axis=2) + SIGMA * rng.standard_normal((40, 2))
        bars = {"bar": lengths[:, :1], "rod": lengths[:, 1:]}
        fits.append(calib.fit(robot, calib.as_measurements(robot, q, bars), starts=10))
    return Situation(*fits, r"(\d) other minimum explains the data as well \(RMS ([\d.]+) mm", (1, 1e3 * SIGMA), 0.3)


@situation(Code.NOISE_AS_LARGE_AS_ROBOT, "FAIL")
def _(shop):
    there = calib.fit(shop.arm, noisy(shop.truth, joints(80), 2.0, 1))
    spread = 1e3 * np.sqrt(np.mean(np.var(there.identification.data.points(shop.arm)[:, 0], axis=0)))
    return Situation(there, shop.good, r"residuals of ([\d.]+) mm .* spread over ([\d.]+) mm", (2000.0, spread), 0.1)


@situation(Code.NO_NOISE, "CHECK")
def _(shop):
    return Situation(calib.fit(shop.arm, noisy(shop.truth, joints(80), 0.0, 1)), shop.good, "computed, not measured")


@situation(Code.NOISE, "PASS")
def _(shop):
    there = calib.fit(shop.arm, noisy(shop.truth, joints(80), 1.6 * SIGMA, 1), sigma=SIGMA)
    says = r"is ([\d.]+) times what was stated \(([\d.]+) mm .* where ([\d.]+) mm"
    return Situation(there, shop.good, says, (1.6, 0.064, 0.04), 0.1)


@situation(Code.MISREAD)
def _(shop):
    robot, rng = calib.load(write_six_axis(shop.new(), POSES)), np.random.default_rng(3)
    q = joints(40)
    T = robot.forward(q, "l6") @ np.block([[np.eye(3), np.array([[0.052], [0.02], [0.1]])], [0, 0, 0, 1]])
    turns = Rotation.from_rotvec(5e-5 * rng.standard_normal((40, 3))) * Rotation.from_matrix(T[:, :3, :3])
    points = T[:, :3, 3] + SIGMA * rng.standard_normal((40, 3))
    fits = []
    for numbers in (turns.as_quat()[:, [3, 0, 1, 2]], turns.as_quat()):
        fits.append(calib.fit(robot, misread.read(shop.new(), robot, q, points, numbers)))
    return Situation(*fits, "probable mistake: .*qw qx qy qz")


@situation(Code.POSES_EQUAL, "FAIL")
def _(shop):
    there = calib.fit(shop.prior, noisy(shop.prior, np.tile(joints(1), (10, 1)), SIGMA, 1))
    return Situation(there, shop.good_prior, "all poses are the same")


@situation(Code.JOINT_NEVER_MOVED)
def _(shop):
    q = joints(80)
    q[:, 3] = 0.2
    return Situation(calib.fit(shop.prior, noisy(shop.prior, q, SIGMA, 1)), shop.good_prior, "joint j4 never moved")


@situation(Code.JOINTS_MOVE_TOGETHER)
def _(shop):
    there = calib.fit(shop.prior, noisy(shop.prior, np.linspace(joints(1)[0], -joints(1)[0], 40), SIGMA, 1))
    return Situation(there, shop.good_prior, r"joints j1, j2, j3, j4, j5, and 1 more along (\d) direction\.", (1,))


@situation(Code.NEAR_SINGULAR)
def _(shop):
    """A parallelogram is singular where its links lie on each other."""
    robot, rng, fits = calib.load(write_parallelogram(shop.new())), np.random.default_rng(3), []
    for last in (0.004, 0.9):
        q = np.append(np.linspace(0.6, 2.4, 30), last)[:, None]
        points = np.column_stack([0.5 * np.cos(q) + 0.5, 0.5 * np.sin(q), 0 * q])[:, None]
        fits.append(calib.fit(robot, measurements(robot, q, points + SIGMA * rng.standard_normal(points.shape))))
    return Situation(*fits, r"(\d) pose is near a singularity .*row 30", (1,))


@situation(Code.TOO_FEW_POSES, "CHECK")
def _(shop):
    there = calib.fit(shop.arm, noisy(shop.truth, joints(11), SIGMA, 1))
    n = int(np.sum(shop.arm.is_free))
    return Situation(there, shop.good, r"(\d+) measured values for (\d+) parameters", (33, n))


@situation(Code.MOVES_AS_ONE)
def _(shop):
    arm = shop.robot(YAML.replace("  ball:", "  other: {frame: l6, xyz: [0, -40 mm, 90 mm]}\n  ball:") + FREE)
    q, rng = joints(60), np.random.default_rng(3)
    errors = (2e-4 * rng.standard_normal((60, targets, 3)) for targets in (1, 2))
    fits = [calib.fit(arm, measurements(arm, q, arm.positions(q) + error)) for error in errors]
    says = r"targets other, ball are the same .* to 1 um, while readings are off by ([\d.]+) mm per axis: these targets"
    return Situation(*fits, rf"{says} were computed from one measured pose\.", (0.2,), 0.2)


@situation(Code.OUTLIERS)
def _(shop):
    points = shop.used.points(shop.arm).copy()
    points[17] += 1e-3
    there = calib.fit(shop.arm, with_points(shop.arm, shop.used, points))
    off = rms(points[17] - there.robot.positions(joints(80))[17])
    says = r"(\d) outlier \(chance.*row 17, ball: ([\d.]+) mm off.*--exclude-outliers"
    return Situation(there, shop.good, says, (1, off))


@situation(Code.MANY_EXCLUDED)
def _(shop):
    points = shop.used.points(shop.arm).copy()
    points[::7] += np.random.default_rng(2).normal(0, 2e-3, points[::7].shape)
    sets = (with_points(shop.arm, shop.used, points), shop.used)
    fits = [calib.fit(shop.arm, data, exclude_outliers=True) for data in sets]
    return Situation(*fits, r"(\d+) of (\d+) poses were excluded", (len(points[::7]), 80), 0.2)


@situation(Code.USED_FOR_BOTH)
def _(shop):
    there = calib.fit(shop.arm, shop.used, validation=shop.used.subset(np.arange(0, 80, 4)))
    says = r"(\d+) of (\d+) validation poses are measurements that the fit has used"
    return Situation(there, shop.good, says, (20, 20))


@situation(Code.DOUBTFUL_READINGS)
def _(shop):
    """The image was turned by a quarter."""
    arm = shop.robot(pixel.YAML)
    q, (camera, body) = joints(20, 5), pixel.places(4)
    table = pixel.photographs(arm.with_parameters(pixel.TRUTH), q, camera, body)
    turned = table.copy()
    turned[:, 2:] = np.stack([1600 - table[:, 3], table[:, 2]], axis=1)
    fits = [calib.fit(arm, pixel.data_of(arm, q, rows, 0.3, 1)) for rows in (turned, table)]
    wide = np.any((turned[:, 2:] < 0) | (turned[:, 2:] > [2000, 1600]), axis=1)
    return Situation(*fits, r"camera 'eye': (\d+) of (\d+) readings lie outside", (np.sum(wide), len(table)), 0.15)


@situation(Code.COPIED)
def _(shop):
    there = calib.fit(shop.arm, shop.used.subset(np.r_[:80, 7, 30, 31]))
    says = r"(\d+) of (\d+) readings are copies of others to the last digit, .*: row 7, row 30, row 31\. Leave"
    return Situation(there, shop.good, says, (3, 83))


@situation(Code.ZERO_READINGS, "FAIL")
def _(shop):
    """Among readings that no correction of one mistake brings right."""
    points = noisy(shop.truth, joints(80), SIGMA, 1).points(shop.arm).copy()
    points[[7, 9]] = 0.0
    robust = calib.fit(shop.arm, measurements(shop.arm, joints(80), points), loss="tukey")
    return Situation(robust, shop.good, r"(\d) poses were read at exactly 0, 0, 0.*row 7, row 9", (2,))


@situation(Code.EQUAL_COLUMNS, "FAIL")
def _(shop):
    """One of two targets was exported with the same column twice; the fit does without it."""
    arm = shop.robot(YAML.replace("  ball:", "  other: {frame: l6, xyz: [0, -40 mm, 90 mm]}\n  ball:") + FREE)
    data = noisy(arm, joints(60), SIGMA, 1)
    points = data.points(arm).copy()
    points[:, 1, 1] = points[:, 1, 0]
    fits = [calib.fit(arm, measurements(arm, joints(60), read), loss="tukey") for read in (points, data.points(arm))]
    return Situation(*fits, "columns ball_x and ball_y are equal in every row")


@situation(Code.REPEATABILITY, "CHECK")
def _(shop):
    """60 poses of three readings each, which scatter by 10 um about what is 50 um off."""
    fits = []
    for scatter, between in ((1e-5, 5e-5), (5e-5, 0.0)):
        rng, q = np.random.default_rng(1), np.repeat(joints(60), 3, axis=0)
        away = np.repeat(between * rng.standard_normal((60, 1, 3)), 3, axis=0)
        points = shop.arm.positions(q) + away + scatter * rng.standard_normal((180, 1, 3))
        names = [f"p{k // 3}" for k in range(180)]
        fits.append(calib.fit(shop.arm, calib.as_measurements(shop.arm, q, points, names)))
    # means of three: 50^2 + 10^2 / 3 against 10^2 / 3
    return Situation(*fits, r"means of repeats are off by ([\d.]+) times", (np.sqrt(1 + 3 * 25),), 0.15)


@situation(Code.ROUNDED)
def _(shop):
    q = joints(80)
    step = np.radians(0.1)
    there = calib.fit(shop.arm, measurements(shop.arm, np.round(q / step) * step, shop.used.points(shop.arm)))
    made = rms(shop.truth.positions(q) - shop.truth.positions(np.round(q / step) * step)) / np.sqrt(3)
    says = r"rounded to steps of ([\d.]+) deg, which makes about ([\d.]+) mm"
    return Situation(there, shop.good, says, (0.1, made), 0.25)


@situation(Code.LEVERAGE)
def _(shop):
    robot, fits = shop.robot(f"priors: false\n{YAML}{ALONE}"), []
    q = joints(60)
    q[:, 5] = 0.3
    q[11, 5] = 1.9
    for values in (q, joints(60)):
        fits.append(calib.fit(robot, noisy(robot, values, SIGMA, 1)))
    return Situation(*fits, r"(\d) pose decides its own prediction.*row 11", (1,))


@situation(Code.FAR_FROM_NOMINAL, "FAIL")
def _(shop):
    there = calib.fit(shop.arm, noisy(shop.arm.with_parameters({"j4.z": 0.15}), joints(80), SIGMA, 1))
    return Situation(there, shop.good, r"j4.z \((\d+) sigma\)", (50,), 0.1)


@situation(Code.AT_BOUNDS, "PASS")
def _(shop):
    there = calib.fit(shop.arm, noisy(shop.arm.with_parameters({"j3.x": 0.02}), joints(80), SIGMA, 1), sigma=SIGMA)
    return Situation(there, shop.good, r"j3.x \(([\d.]+) sigma\)", (10,), 0.1)


@situation(Code.LENGTHS_SCALED)
def _(shop):
    points = shop.off(shop.prior).positions(joints(60)) + SIGMA * np.random.default_rng(5).standard_normal((60, 1, 3))
    fits = [calib.fit(shop.prior, measurements(shop.prior, joints(60), scale * points)) for scale in (1.016, 1.0)]
    return Situation(*fits, r"([\d.]+) % longer", (1.6,), 0.15)


@situation(Code.LARGE_TERMS)
def _(shop):
    """Joint 2 is off by a wave of 60 times what is usual; the size found is that of four waves of six joints."""
    there = fit_with_term("harmonics", "joint_2.sin2", 60.0)
    return Situation(there, shop.small_gain, r"harmonics \((\d+) times\)", (60.0 / np.sqrt(24),), 0.1)


@situation(Code.JOINT_SCALED)
def _(shop):
    """Joint 2 turns 3 % too far, 30 times as much as is usual."""
    there = fit_with_term("gain", "joint_2.gain", 30.0)
    return Situation(there, shop.small_gain, r"joint_2 ([\d.]+) times as far", (1.03,), 1e-3)


def fit_with_term(term, name, times):
    """A fit of the example arm whose joint 2 has a term of so many times its usual size."""
    robot = calib.load(EXAMPLES / "arm.yaml")
    real = robot.with_terms(parse_terms(f"joint_2={term}"))
    true = real.with_parameters({name: times * real.parameters[name].sigma_si})
    q = np.random.default_rng(19).uniform(-1.5, 1.5, (40, 6))
    points = true.positions(q) + 2e-5 * np.random.default_rng(20).standard_normal((40, 1, 3))
    return calib.fit(robot, measurements(robot, q, points), terms="auto")


@situation(Code.TOLERANCE)
def _(shop):
    stated = (f"{NO_PRIORS}{YAML}{FREE}tolerance: {tolerance} mm\n" for tolerance in (0.05, 0.5))
    fits = [calib.fit(shop.robot(yaml), shop.used) for yaml in stated]
    limit = 1e3 * fits[0].verdict.claim.at_measured_poses.limit95
    return Situation(*fits, r"the claim is ([\d.]+) mm .* the tolerance of ([\d.]+) mm", (limit, 0.05))


@situation(Code.UNLIKE_FLEET)
def _(shop):
    robot, rng, folder = calib.load(fleet_figures.ROBOT), np.random.default_rng(5), shop.new()
    mean = fleet_figures.made_up(robot, rng)
    fleet = calib.fleet(*fleet_figures.results_of(robot, folder, 3, rng, mean))
    truth, fits = fleet_figures.one_more(robot, mean, rng), []
    q, bent = robot.sample(20, rng), np.array([parameter.name == "joint_3.rz" for parameter in robot.parameters])
    for more in (0.02, 0.0):
        repaired = truth.with_parameters(truth.values + more * bent)
        fits.append(calib.fit(fleet.robot, calib.simulate(repaired, q, seed=3)))
    return Situation(*fits, r"unlike the (\d) robots of its fleet in joint_3.rz", (3,))


@situation(Code.RANK_UNCLEAR)
def _(shop):
    """Joint 6 moves by so little that its column is nothing but for the last digits."""
    robot, fits = shop.robot(f"priors: false\n{YAML}{ALONE}"), []
    for reach in (3e-8, 1.0):
        q = joints(60)
        q[:, 5] = 0.3 + reach * q[:, 5]
        fits.append(calib.fit(robot, noisy(robot, q, SIGMA, 1)))
    return Situation(*fits, "no clear gap: singular value")


@situation(Code.NOT_LINEAR)
def _(shop):
    there = calib.fit(shop.arm, noisy(shop.truth, 0.02 * joints(40), SIGMA, 1))
    return Situation(there, shop.good, r"hardly determined angles: .*\+-[\d.]+ deg")


@situation(Code.ONE_CORNER)
def _(shop):
    q = joints(80)
    near = q[:1] + 0.05 * (q - q[:1])
    there, range_used = calib.fit(shop.prior, noisy(shop.prior, near, SIGMA, 1), sigma=SIGMA), np.ptp(near, axis=0)
    return Situation(there, shop.good_prior, r"more than ([\d.]+) % of its range", (100 * range_used.max() / 6,), 0.03)


@situation(Code.JOINT_MOVED_LITTLE)
def _(shop):
    q = joints(80)
    q[:, 2] = 0.3 + 0.01 * q[:, 2]
    there = calib.fit(shop.prior, noisy(shop.prior, q, SIGMA, 1), sigma=SIGMA)
    moved = np.degrees(np.ptp(q[:, 2]))
    return Situation(there, shop.good_prior, r"joint j3 moved through only ([\d.]+) deg", (moved,), 0.03)


@situation(Code.VALIDATED_ELSEWHERE)
def _(shop):
    near = noisy(shop.prior, joints(60) / 4, SIGMA, 1)
    held = [noisy(shop.prior, joints(30, 5) / by, SIGMA, 2) for by in (1, 4)]
    fits = [calib.fit(shop.prior, near, sigma=SIGMA, validation=other) for other in held]
    covariance = fits[0].predict(joints(30, 5)).covariance
    known = 1e3 * np.median(np.sqrt(np.trace(covariance, axis1=-2, axis2=-1)))
    return Situation(*fits, r"known to ([\d.]+) mm there", (known,), 0.06)


@situation(Code.BEYOND_JOINT_LIMITS, "PASS")
def _(shop):
    q = joints(80)
    q[[3, 7], 2] = 3.2, -3.5
    there = calib.fit(shop.arm, noisy(shop.truth, q, SIGMA, 1), sigma=SIGMA)
    return Situation(there, shop.good, r"(\d) poses lie beyond the URDF's limits of joint j3: row 3, row 7", (2,))


@situation(Code.TURNS_NOT_COUNTED)
def _(shop):
    path = write_six_axis(shop.new(), YAML + FREE + "  - {joint: j1, term: gain}\n")
    urdf = path.parent / "arm.urdf"
    urdf.write_text(urdf.read_text().replace('name="j1" type="revolute"', 'name="j1" type="continuous"'))
    robot, fits = calib.load(path), []
    turns = np.linspace(-7.0, 9.0, 60)
    for first in ((turns + np.pi) % (2 * np.pi) - np.pi, turns):
        q = joints(60)
        q[:, 0] = first
        fits.append(calib.fit(robot, noisy(robot, q, SIGMA, 1)))
    return Situation(*fits, "joint j1 lie within one turn")


@situation(Code.BEYOND_CURVES)
def _(shop):
    """The second joint has a curve, measured from -1 to 1 rad alone."""
    robot, rng, fits = calib.load(EXAMPLES / "arm.yaml"), np.random.default_rng(14), []
    q, other = rng.uniform(-1.0, 1.0, (100, 6)), rng.uniform(-1.0, 1.0, (5, 6))

    def measured(q):
        gear = q.copy()
        gear[:, 1] += 4e-4 * np.sin(11 * q[:, 1])
        return measurements(robot, q, robot.positions(gear) + 2e-5 * rng.standard_normal((len(q), 1, 3)))

    used = measured(q)
    for further in (2.0, 0.0):
        far = other.copy()
        far[:, 1] += further
        fits.append(calib.fit(robot, used, validation=measured(far), terms="joint_2=curve"))
    return Situation(*fits, r"(\d) validation poses lie where no error curve of joint_2 was learned", (5,))


def bent(q):
    """Where joints stand if the error of the first depends on two others."""
    return q + np.outer(2e-4 * np.sin(q[:, 1]) * np.cos(2.0 * q[:, 2]), np.eye(6)[0])


@situation(Code.BLOCKS_DISAGREE, "CHECK")
def _(shop):
    q, noise = joints(120), SIGMA * np.random.default_rng(1).standard_normal((120, 1, 3))
    points = [shop.prior.positions(stood) + noise for stood in (bent(q), q)]
    fits = [calib.fit(shop.prior, measurements(shop.prior, q, read)) for read in points]
    return Situation(*fits, r", ([\d.]+) times more than noise", (fits[0].interval_factor,), 0.05)


@situation(Code.TERMS_UNTESTED)
def _(shop):
    rng = np.random.default_rng(3)
    together = np.sin(rng.uniform(-1.0, 1.0, (60, 3)) @ rng.uniform(-1.0, 1.0, (3, 6)))
    sets = [noisy(shop.prior, q, SIGMA, 1) for q in (together, joints(60))]
    fits = [calib.fit(shop.prior, data, sigma=SIGMA, terms="gain") for data in sets]
    return Situation(*fits, "positions are known to .* RMS there")

"""Whether compensation harms a good robot, and whether it promises what it keeps, on simulated robots.

    python -m tests.programs.compensated_robots [--seeds 20] [--robots arm,delta] [--places known,unknown] [--unstated]

prints a table, of which docs/howto/accurate_robot.md has the ranges. Each robot is measured at 40 random poses
with 0.02 mm of noise (stated, unless --unstated) and calibrated; a program of 60 random poses is compensated. Robots
without errors are exactly as described, and are judged twice: as they are, and with the verdict ignored that nothing
is to be corrected. The others have errors drawn from what the description expects (MedRUE: those of the paper's Table
I, signs drawn). Base and tool are known, or both unknown, with a tracker that stands somewhere and a reflector off by
what is expected of it.

The truth is judged in the frame that is stated: measured, or laid where the true and the nominal robot agree best.
That is done here by other code: rigid motions written out, their derivatives by differences, SciPy's least squares.
"Not laid" is what somebody sees whose base and tool are where the true robot has them, and stay there.

Errors before, after and expected are root mean squares over all rows. "After/expected" is the root mean square of the
ratio of each row: next to a singular pose the error that is expected grows beyond all others, so that one row in 3000
would decide the ratio of root mean squares.
"""

import argparse
import re
import sys
import tempfile
from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

import calib
from calib.core.base.errors import CalibrationError
from calib.core.data.in_memory import as_measurements, as_poses
from calib.core.judging.acceptance import verify, visible_changes
from calib.core.judging.promise import Promise
from calib.programs.languages.correction_grid import correction_grid
from calib.programs.languages.straight_moves import StraightMoves, compensate_moves
from calib.starting.templates import TEMPLATES
from medrue import robot_file
from medrue.paper_tables import table1
from tests.project import EXAMPLES

PLACES = ("known", "tool unknown", "unknown")
ROBOTS = ("arm", "five_bar", "rail_and_five_bar", "delta", "stewart", "medrue")
NOISE, N_MEASURED, N_PROGRAM = 2e-5, 40, 60
TRACKER = {"base.x": 0.3, "base.y": -1.2, "base.z": 0.1, "base.rx": 0.02, "base.ry": -0.01, "base.rz": 0.5}
RAIL = (
    '<link name="floor"/><joint name="rail" type="prismatic"><parent link="floor"/><child link="base"/>'
    '<axis xyz="0 0 1"/><limit lower="-0.3" upper="0.3" effort="1" velocity="1"/></joint></robot>'
)
OF_RAIL = """parametrisation:
  - {origin: rail, components: [x, y, z], sigma: 1 mm}
  - {origin: rail, components: [rx, ry, rz], sigma: 5 mrad}
  - {origin: left_motor, components: [rx, ry], sigma: 5 mrad}
"""
MEDRUE_ANYWHERE = """parametrisation:
  - {origin: all, components: [x, y, z], sigma: 1 mm}
  - {origin: all, components: [rx, ry, rz], sigma: 5 mrad}
"""


def described(name, folder, places, stated=False):
    """A robot as described; of `PLACES`, what is known of base and tool; whether the noise is stated."""
    known = places != "unknown"
    if name == "medrue":
        text = Path(robot_file()).read_text()
        text = text.replace("urdf: medrue.urdf", f"urdf: {Path(robot_file()).parent / 'medrue.urdf'}")
        if not known:
            text = text.replace("base: {frame: world}", "base: {frame: world, pose: unknown}")
            text = text.replace("tool: {frame: tool}", "tool: {frame: tool, position: unknown, sigma: 2 mm}")
            text = re.sub(r"parametrisation: medrue\nheld: .*\n(#.*\n)?elimination_order: .*\n", MEDRUE_ANYWHERE, text)
    elif name == "arm":
        text = (EXAMPLES / "arm.yaml").read_text().replace("urdf: arm.urdf", f"urdf: {EXAMPLES / 'arm.urdf'}")
    else:
        template = name.removeprefix("rail_and_")
        urdf, text = TEMPLATES[template].files(f"{name}.urdf")
        if name != template:
            urdf = urdf.replace("</robot>", RAIL)
            text = text.replace("name_mot: [", "name_mot: [rail, ").replace("{frame: base,", "{frame: floor,")
            text = text.replace("home:\n", "home:\n  rail: 0.0\n").replace("parametrisation:\n", OF_RAIL)
        (folder / f"{name}.urdf").write_text(urdf)
    if known:
        text = text.replace("pose: unknown", "pose: known")
    if places == "known":
        text = re.sub(r"position: unknown(, sigma: \d+ mm)?", "position: known", text)
    text = re.sub(r"(# )?sigma: 0.0. mm\n", f"sigma: {1e3 * NOISE:g} mm\n" if stated else "", text)
    (folder / f"{name}.yaml").write_text(text)
    return calib.load(folder / f"{name}.yaml")


def true_robot(nominal, errors, rng):
    """A robot of this make: nominal, or with errors; an unknown reflector and tracker stand somewhere."""
    values = {}
    for p, free in zip(nominal.parameters, nominal.is_free, strict=True):
        if (p.placement and p.prior) or (errors and free and not p.placement):
            values[p.name] = p.nominal_si + p.sigma_si * rng.standard_normal()
    if errors and nominal.parameters[0].name == "A1y":
        table = table1()
        signs = rng.choice([-1.0, 1.0], len(table.names))
        values = dict(zip(table.names, table.nominal + signs * (table.actual - table.nominal), strict=True))
    names = {p.name for p in nominal.parameters}
    return nominal.with_parameters(values | {name: value for name, value in TRACKER.items() if name in names})


def poses_of(robot, q):
    """Positions (n, n_targets, 3) and rotations (n, n_targets, 3, 3) of the targets."""
    poses = np.stack([robot.forward(q, name) for name in robot.target_names], axis=1)
    return robot.positions(q), poses[..., :3, :3]


class TrueFrame:
    """The nominal robot in the frame of the true one, from the docstring of `calib.core.rows.common_motion`."""

    def __init__(self, truth, nominal, joints):
        self.nominal, self.anywhere = nominal, nominal.description.base.pose == "unknown"
        if not self.anywhere:
            places = {p.name: v for p, v in zip(truth.parameters, truth.values, strict=True) if p.placement}
            self.nominal = nominal.with_parameters(places)
            return
        onto, (own, turned) = truth.positions(joints), poses_of(nominal, joints)
        self.centre, self.length, n = onto.mean(axis=(0, 1)), nominal.mechanism.length, 6 + 3 * onto.shape[1]
        spread = (x.reshape(-1, 3) - x.mean(axis=(0, 1)) for x in (onto, own))
        self.turn = Rotation.align_vectors(*spread)[0].as_matrix()
        self.shift = self.centre - self.turn @ own.mean(axis=(0, 1))
        near = self.placed(own, turned)
        columns = [(self.moved(*near, h) - self.moved(*near, -h)).ravel() / 2e-6 for h in 1e-6 * np.eye(n)]
        _, values, right = np.linalg.svd(np.stack(columns, axis=1) / np.sqrt(onto.size / 3), full_matrices=False)
        basis = right[values > 0.03].T
        best = scipy.optimize.least_squares(
            lambda z: 1e3 * (self.moved(*near, basis @ z) - onto).ravel(), np.zeros(basis.shape[1]), xtol=1e-14
        )
        self.motion = basis @ best.x

    def placed(self, positions, rotations):
        """Poses seen from about where the tracker is."""
        return positions @ self.turn.T + self.shift, self.turn @ rotations

    def moved(self, positions, rotations, m):
        """Positions where the base is shifted and turned about the centroid, and tools are shifted on their links."""
        positions = positions + np.einsum("ntij,tj->nti", rotations, m[6:].reshape(-1, 3))
        turn = Rotation.from_rotvec(m[3:6] / self.length).as_matrix()
        return (positions - self.centre) @ turn.T + self.centre + m[:3]

    def meant(self, q):
        """Where the nominal robot brings its targets at joints, positions and rotations, in the true robot's frame."""
        poses = poses_of(self.nominal, q)
        if not self.anywhere:
            return poses
        positions, rotations = self.placed(*poses)
        turn = Rotation.from_rotvec(self.motion[3:6] / self.length).as_matrix()
        return self.moved(positions, rotations, self.motion), turn @ rotations


@dataclass
class Trial:
    """One calibrated robot and its program."""

    nominal: calib.Robot
    truth: calib.Robot
    fit: object
    frame: TrueFrame
    program: np.ndarray

    @staticmethod
    def of(nominal, errors, seed):
        """Measure and calibrate."""
        rng = np.random.default_rng([seed, errors, len(nominal.parameters)])
        truth = true_robot(nominal, errors, rng)
        joints, program = nominal.sample(N_MEASURED, seed=rng), nominal.sample(N_PROGRAM, seed=rng)
        joints, program = (q[truth.close(q).ok] for q in (joints, program))
        measured = truth.positions(joints)
        measured = measured + NOISE * rng.standard_normal(measured.shape)
        fit = calib.fit(
            nominal, as_measurements(nominal, joints, measured if measured.shape[1] > 1 else measured[:, 0])
        )
        program = program[fit.robot.close(program).ok]  # passive joints keep their limits, ours and the true robot's
        return Trial(nominal, truth, fit, TrueFrame(truth, nominal, joints), program)

    def known(self, verdict):
        """What is known of the robot; whether its verdict counts."""
        known = self.fit.known_robot
        return known if verdict else replace(known, nothing_to_correct=False)


def rms(distances):
    return float(np.sqrt(np.mean(np.square(distances))))


def lengths(off):
    return np.linalg.norm(off, axis=-1)


def angles(rotations, others):
    return Rotation.from_matrix(rotations @ others.swapaxes(1, 2)).magnitude()


def of_program(trial, known, goals=None):
    """Errors of a compensated program: after, expected, limit, before, fixtures as drawn; and of its turns."""
    compensated = calib.compensate(known, trial.program if goals is None else goals)
    ok = compensated.ok.copy()
    ok[ok] = trial.truth.close(compensated.q[ok]).ok  # the true robot stops at the end of a passive joint
    q, commands = trial.program[ok], compensated.q[ok]
    t = trial.nominal.target_names.index(compensated.target)
    (meant, turned), (did, real), (plain, _) = (
        (x[:, t], R[:, t]) for x, R in (trial.frame.meant(q), poses_of(trial.truth, commands), poses_of(trial.truth, q))
    )
    places = {p.name: v for p, v in zip(trial.truth.parameters, trial.truth.values, strict=True) if p.placement}
    fixed = trial.nominal.with_parameters(places).positions(q)[:, t]
    rows = {
        "": (
            lengths(did - meant),
            compensated.expected[ok],
            compensated.high95[ok],
            lengths(plain - meant),
            lengths(trial.truth.positions(commands)[:, t] - fixed),
        )
    }
    if compensated.kept_components == "pose":
        nothing = np.full(len(q), np.nan)
        rows[" (angle)"] = (
            angles(real, turned),
            compensated.expected_angle[ok],
            compensated.high95_angle[ok],
            nothing,
            nothing,
        )
    return rows


def pose_goals(trial, program):
    """The places to which a nominal controller brings its tool at joints of the program."""
    name = trial.nominal.target_names[0]
    positions, rotations = poses_of(trial.nominal, program)
    whole = len(trial.nominal.joint_names) == 6
    return calib.Goals(positions[:, 0], rotations[:, 0] if whole else None, target=name)


def of_solve(trial, known):
    """Errors of joint values that are to reach places in the measurement frame."""
    program = trial.program[:30]
    positions, rotations = poses_of(trial.fit.robot, program)
    goals = positions[:, 0].copy()
    if len(trial.nominal.joint_names) == 2:
        goals[:, 2] = np.nan  # it moves in a plane
    whole = len(trial.nominal.joint_names) == 6
    solution = calib.solve(known, calib.Goals(goals, rotations[:, 0] if whole else None), near=program)
    ok, expected = solution.ok, solution.expected
    off = np.nan_to_num(trial.truth.positions(solution.q[ok])[:, 0] - goals[ok])
    nothing = np.full(int(np.sum(ok)), np.nan)
    return {"": (lengths(off), expected.distance[ok], expected.distance95[1, ok], nothing, nothing)}


def driven_nominally(trial, told):
    """Where the true robot goes when a nominal controller is told places, and where the nominal one would."""
    q = calib.solve(trial.nominal, told, near=trial.nominal.home).q
    return trial.truth.positions(q)[:, 0], trial.frame.meant(q)[0][:, 0]


def box_of(trial):
    """Corners of a box around home, which three motors reach."""
    return trial.nominal.positions(trial.nominal.home)[0, 0] + np.outer([-1, 1], [0.03, 0.04, 0.02])


def of_gcode(trial, known):
    """Errors at the ends of straight moves."""
    rng, corners = np.random.default_rng(0), box_of(trial)
    ends = rng.uniform(*corners, (12, 3))
    moves = StraightMoves(np.vstack([corners[:1], ends[:-1]]), ends, tuple(f"move {k}" for k in range(12)))
    compensated = compensate_moves(known, moves, 2e-5)
    (did, _), (plain, meant) = (
        driven_nominally(trial, x) for x in (np.array([way[-1] for way in compensated.waypoints]), ends)
    )
    nothing = np.full(12, np.nan)
    return {"": (lengths(did - meant), compensated.expected, nothing, lengths(plain - meant), nothing)}


def of_grid(trial, known):
    """Errors at the nodes of a table of corrections."""
    grid = correction_grid(known, calib.Goals(box_of(trial)), (3, 3, 3))
    (did, _), (plain, meant) = (driven_nominally(trial, x) for x in (grid.nodes + grid.shift, grid.nodes))
    nothing = np.full(len(grid.nodes), np.nan)
    return {"": (lengths(did - meant), grid.expected_error, nothing, lengths(plain - meant), nothing)}


def of_plan(trial, rng):
    """Whether a change of the size that a plan calls visible is seen, and whether an unchanged robot agrees."""
    nominal, promise = trial.nominal, Promise.from_calibration(trial.fit)
    poses = as_poses(nominal, trial.program)
    sigma = {p.name: p.sigma_si for p in nominal.parameters}
    changes = [c for c in visible_changes(promise, poses) if c.visible < 5 * sigma.get(c.name, 0.0)]

    def verdict(robot):
        q = trial.program[robot.close(trial.program).ok]
        measured = robot.positions(q) + NOISE * rng.standard_normal((len(q), len(nominal.target_names), 3))
        acceptance = verify(
            trial.fit, as_measurements(nominal, q, measured if measured.shape[1] > 1 else measured[:, 0])
        )
        off = np.concatenate(list(acceptance.errors.after.values()))
        return acceptance.verdict, rms(lengths(off)) / acceptance.expected_rms

    agrees, ratio = verdict(trial.truth)
    if not changes:
        return agrees == "agrees", ratio, None
    change = changes[rng.integers(len(changes))]
    place = [p.name for p in nominal.parameters].index(change.name)
    changed = trial.truth.with_parameters({change.name: trial.truth.values[place] + change.visible})
    return agrees == "agrees", ratio, verdict(changed)[0] != "agrees"


FORMS = {
    "joints": lambda trial, known: of_program(trial, known),
    "poses": lambda trial, known: of_program(trial, known, pose_goals(trial, trial.program)),
    "solve": of_solve,
    "G-code": of_gcode,
    "grid": of_grid,
}
OF_THREE_AXES = ("G-code", "grid")


def row(cells):
    """A row of the table from the errors of all seeds: root mean squares, that of ratios, and rows beyond the limit."""
    after, promised, high, before, fixed = (np.concatenate(part) for part in zip(*cells, strict=True))
    size = [1e3 * rms(part) for part in (before, after, promised, fixed)]
    beyond = np.mean(after > high) if np.all(np.isfinite(high)) else np.nan
    numbers = (*size[:3], rms(after / promised), 100 * beyond, size[3])
    return " | ".join(
        "" if np.isnan(x) else f"{x:.4f}" if k not in (3, 4) else f"{x:.2f}" for k, x in enumerate(numbers)
    )


def main(robots, places, seeds, stated):
    """Print the tables."""
    print("| robot | places | errors | program | before [mm] | after | expected | after/expected | beyond 95 % [%] |"
          " after, fixtures as drawn |", flush=True)  # fmt: skip
    plans = []
    for name in robots:
        for where in places:
            for errors in (False, True):
                with tempfile.TemporaryDirectory() as folder:
                    plans.append(of_make(name, described(name, Path(folder), where, stated), where, errors, seeds))
    print("\n| robot | places | errors | nothing to correct | verify agrees | measured/expected | changes seen |")
    print("\n".join(plans))


def of_make(name, nominal, places, errors, seeds):
    """Print the rows of robots of one make; return what verify says of them."""
    cells, seen, kept = defaultdict(list), [], 0
    for seed in range(seeds):
        try:
            trial = Trial.of(nominal, errors, seed)
        except CalibrationError as error:
            print(f"{name}, seed {seed}: {error}", file=sys.stderr)
            continue
        kept += trial.fit.known_robot.nothing_to_correct
        for verdict in (True,) if errors else (True, False):
            for form, judge in FORMS.items():
                if form not in OF_THREE_AXES or name in ("delta", "rail_and_five_bar"):
                    for ending, cell in judge(trial, trial.known(verdict)).items():
                        cells[verdict, form + ending].append(cell)
        seen.append(of_plan(trial, np.random.default_rng(seed)))
    for (verdict, form), cell in cells.items():
        which = "as expected" if errors else "none" if verdict else "none, verdict ignored"
        print(f"| {name} | {places} | {which} | {form} | {row(cell)} |", flush=True)
    agree, ratios, terms_found = zip(*seen, strict=True)
    terms_found = [named for named in terms_found if named is not None]
    return (
        f"| {name} | {places} | {'as expected' if errors else 'none'} | {kept} of {len(seen)} | {sum(agree)} of"
        f" {len(seen)} | {rms(ratios):.2f} | {sum(terms_found)} of {len(terms_found)} |"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", default=",".join(ROBOTS), help="which, with commas between")
    parser.add_argument("--places", default="known,unknown", help=f"which, of {', '.join(PLACES)}")
    parser.add_argument("--seeds", type=int, default=20, help="robots of each kind")
    parser.add_argument("--unstated", action="store_true", help="do not state the noise of the readings")
    options = parser.parse_args()
    main(options.robots.split(","), options.places.split(","), options.seeds, not options.unstated)

"""What a fleet is worth, simulated: `python -m tests.fleets.fleet_figures [--robots 5] [--draws 10] [--spread 0.05]`.

In each draw a model is made up: the mean of its robots is off from nominal by `--mean` of what the description expects
of each parameter, and the robots scatter around it by `--spread` of that. Intervals of parameters that no pose shows
are as wide as the description says, so 95 % of them hold the truth with `--mean 1`, and more with less. The robots of
the fleet are measured at 30 poses each, with base and reflector elsewhere each time, and calibrated one by one. Then
one more robot is measured at 5, 10 and 20 poses, and calibrated with and without what the fleet says. Errors are of
positions at 200 other poses.
Cases: `plain`; `wrong`: one result of the fleet is of a robot ten times as far from the mean in everything; `unlike`:
the new robot has been repaired, and its elbow is off by 20 spreads. The new robot's poses are random, or with
`--chosen` those that `calib.select` takes out of 300 for the least error: 5 and 10 knowing the fleet, 20 not knowing
it. With `--known`, base and reflector are where the description says, for every robot. With `--true-model`, the true
mean and spread stand for the fleet: nothing that could be learned from any fleet is better.
"""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import calib
from calib.core.robots.fleet_prior import FleetParameter, FleetSection
from tests.project import EXAMPLES, copied

ROBOT = EXAMPLES / "arm.yaml"
MEAN, SPREAD = 0.7, 0.05  # over what the description expects: of the mean from nominal, of robots from the mean
REPAIRED = "joint_3.ry"


def own(robot):
    """Parameters that robots share, and those that are places."""
    places = np.array([p.placement for p in robot.parameters])
    return np.flatnonzero(~places), np.flatnonzero(places)


def one_more(robot, mean, rng, spread=SPREAD):
    """A robot of the model, whose base and reflector stand anywhere."""
    sigma = np.array([p.sigma_si for p in robot.parameters])
    shared, places = own(robot)
    values = robot.values.copy()
    values[shared] = mean[shared] + spread * sigma[shared] * rng.standard_normal(len(shared))
    values[places] += np.array([0.3 if p.startswith("base") else 2e-3 for p in names(robot, places)]) * rng.uniform(
        -1, 1, len(places)
    )
    return robot.with_parameters(values)


def names(robot, which):
    return [robot.parameters[int(k)].name for k in which]


def made_up(robot, rng, part=MEAN):
    """Values of the mean of a model."""
    sigma = np.array([p.sigma_si for p in robot.parameters])
    mean = robot.values + part * sigma * rng.standard_normal(len(sigma))
    _, places = own(robot)
    mean[places] = robot.values[places]
    return mean


def results_of(robot, folder, n, rng, mean, wrong=False, spread=SPREAD):
    """Result folders of a fleet of n robots; the first is of another model where one is to be wrong."""
    folders = []
    for k in range(n):
        truth = one_more(robot, mean, rng, (10.0 if wrong and k == 0 else 1.0) * spread)
        data = calib.simulate(truth, robot.sample(30, rng), seed=rng)
        folders.append(Path(folder) / f"robot_{k + 1}")
        calib.fit(robot, data).save(folders[-1], force=True, pages=False)
    return folders


def measures(fit, truth, q):
    """Root mean square error of positions at poses q [mm], and parts of intervals that hold the truth."""
    error = fit.robot.positions(q) - truth.positions(q)
    predicted = fit.predict(q)
    std = np.sqrt(np.diagonal(predicted.covariance, axis1=2, axis2=3))
    held = np.abs(error) <= predicted.coverage_factor * std
    shared, _ = own(fit.nominal)
    rows = [fit.parameters[name] for name in names(fit.nominal, shared)]
    inside = [
        estimate.low95_si <= truth.values[k] <= estimate.high95_si for k, estimate in zip(shared, rows, strict=True)
    ]
    return 1e3 * float(np.sqrt(np.mean(np.sum(error**2, axis=2)))), float(np.mean(held)), float(np.mean(inside))


def described(folder, known):
    """The robot that is calibrated, its base and its reflector known or not."""
    return calib.load(copied(Path(folder), ROBOT, ("unknown", "known"), (", sigma: 5 mm", "")) if known else ROBOT)


def knowing(robot, mean, spread):
    """The robot of a model of which mean and spread are known."""
    sizes = {
        name: FleetParameter(offset=mean[k] - robot.values[k], spread=spread * robot.parameters[k].sigma_si, unsure=())
        for k, name in zip(own(robot)[0], names(robot, own(robot)[0]), strict=True)
    }
    fleet = FleetSection(robots=1000, noise_freedom=1000.0, parameters=sizes)
    return replace(robot, description=robot.description.model_copy(update={"fleet": fleet}))


def draw(seed, n, case, spread=SPREAD, chosen=False, known_place=False, true_model=False, part=MEAN):
    """Errors and parts held by what was measured, and what was said of robots that are unlike."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        robot = described(folder, known_place)
        mean = made_up(robot, rng, part)
        if true_model:
            known, odd = knowing(robot, mean, spread), []
        else:
            fleet = calib.fleet(*results_of(robot, folder, n, rng, mean, case == "wrong", spread))
            odd = [member.name for member in fleet.members if member.is_unlike]
            fleet.save(Path(folder) / "fleet.yaml")
            known = calib.load(Path(folder) / "fleet.yaml")
    truth = one_more(robot, mean, rng, spread)
    if case == "unlike":
        place = names(robot, range(len(robot.parameters))).index(REPAIRED)
        off = 20 * spread * robot.parameters[place].sigma_si
        truth = truth.with_parameters({REPAIRED: truth.values[place] + off})
    q = robot.sample(200, rng)
    if chosen:
        candidates = robot.sample(300, rng)
        few, some, many = (
            candidates[np.sort(calib.select(start, candidates, count, "task").chosen)]
            for start, count in ((known, 5), (known, 10), (robot, 20))
        )
    else:
        few, some, many = (robot.sample(count, rng) for count in (5, 10, 20))
    figures, unlike = {}, ()
    for name, start, poses in (
        ("5 poses", robot, few),
        ("5 poses with the fleet", known, few),
        ("10 poses with the fleet", known, some),
        ("20 poses", robot, many),
        ("20 poses with the fleet", known, many),
    ):
        data = calib.simulate(truth, poses, seed=rng.spawn(1)[0])
        try:
            fit = calib.fit(start, data)
        except calib.NotIdentifiableError:
            figures[name] = (np.nan,) * 3
            continue
        figures[name] = measures(fit, truth, q)
        said = fit.nominal.description.fleet
        unlike = said.unlike if said is not None else unlike
    return figures, odd, unlike


def part_of(held):
    """Mean over the draws, +- 1.96 standard errors: what one draw holds hangs together."""
    return f"{100 * np.mean(held):.1f} +- {196 * np.std(held, ddof=1) / np.sqrt(len(held)):.1f} %"


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=5)
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--case", choices=("plain", "wrong", "unlike"), default="plain")
    parser.add_argument("--spread", type=float, default=SPREAD)
    parser.add_argument("--mean", type=float, default=MEAN)
    parser.add_argument("--chosen", action="store_true")
    parser.add_argument("--known", action="store_true")
    parser.add_argument("--true-model", action="store_true")
    told = parser.parse_args()
    chosen = (told.robots, told.case, told.spread, told.chosen, told.known, told.true_model, told.mean)
    drawn = [draw(seed, *chosen) for seed in range(told.draws)]
    poses = " ".join(("chosen" if told.chosen else "random", "poses,", "known" if told.known else "new", "places"))
    fleets = "true models" if told.true_model else f"simulated fleets of {told.robots} robots"
    print(f"{told.draws} {fleets}, mean {told.mean:g}, spread {told.spread:g}, '{told.case}', {poses}")
    for name in drawn[0][0]:
        error, held, inside = np.array([figures[name] for figures, _, _ in drawn]).T
        if np.any(np.isnan(error)):
            print(f"{name:24} no answer in {np.sum(np.isnan(error))} draws: no degree of freedom is left")
            continue
        print(
            f"{name:24} {np.sqrt(np.mean(error**2)):.3f} mm RMS; 95 % intervals hold {part_of(held)} of coordinates,"
            f" {part_of(inside)} of parameters"
        )
    print("named in the fleet:", [len(odd) for _, odd, _ in drawn], "named of the new robot:", [x for _, _, x in drawn])


if __name__ == "__main__":
    main()

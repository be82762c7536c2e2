"""How far predictions by disjoint halves of real measurements lie apart, and how far the fits say that they do.

    python -m tests.halves FOLDER [--draws N] [--only WORDS] [--page]

FOLDER holds measurements by others, as `tests/public_data.py` reads them. Positions at all poses are predicted by the
fits of two halves. What both fits leave to the same prior is off by the same in both, and does not count; nor does the
error of the joints that differs from pose to pose. --page writes the table into docs/uncertainty.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

import calib
from calib.core.base.arrays import FloatArray, IntArray
from calib.core.data.measurements import Measurements
from calib.core.data.pose_groups import boxes
from calib.core.fitting.regions import BLOCKS
from tests.claims import positioner
from tests.project import EXAMPLES
from tests.public_data import PLACES, markdown, motoman, mukca, of_folder, ur10_tracker, written

PAGE = EXAMPLES.parent / "uncertainty.md"
WAYS = {"at random": None, "by boxes of joint space": None, "at random, terms chosen": "auto"}
"""How a set is cut, and which joint terms the fits have."""
_QUICK = 5  # times as many pairs of halves where no terms are chosen


def sets(folder: Path) -> Iterator[tuple[str, calib.Robot, Measurements]]:
    """Yield each robot with its measurements."""
    robot, data, _ = ur10_tracker(folder / "ur10_tracker")
    yield "UR10, 300 poses", robot, data[np.sort(np.random.default_rng(7).permutation(len(data))[:300])]
    yield "Motoman", *motoman(folder / "motoman_right")[:2]
    yield "positioner", *positioner(folder)
    for arm, places in PLACES.items():
        yield arm, *mukca(folder / "mukca", arm, places)


def halves(robot: calib.Robot, data: Measurements, how: str, rng: np.random.Generator) -> tuple[IntArray, IntArray]:
    """Cut the visits in two: at random within each setup, or into boxes of joint space."""
    if how.startswith("by boxes"):
        box = boxes(data.joints, data.pose_numbers, BLOCKS, robot.mechanism.depths)
        n = int(np.max(box)) + 1
        chosen = np.isin(box, rng.permutation(n)[: n // 2])
    else:
        chosen = np.zeros(len(data), dtype=bool)
        setups = np.zeros(len(data)) if data.setups is None else data.setups
        for setup in np.unique(setups):
            there = rng.permutation(np.flatnonzero(setups == setup))
            chosen[there[: len(there) // 2]] = True
    return np.flatnonzero(chosen), np.flatnonzero(~chosen)


def predicted(fit: calib.Calibration, data: Measurements) -> tuple[FloatArray, float, float, dict[str, FloatArray]]:
    """Return positions (n, 3), their variance without blocks left out, as claimed, and the errors left to priors.

    The variances are means over positions. The errors left to priors are columns (3 n,), one for each parameter.
    """
    known, robot, located = fit.uncertainty, fit.robot, fit.robot.reported_targets
    linear, lasting = known.linearise(robot, data.joints, data.conditions), known.lasting(robot)
    columns = linear.jacobian[:, located, :3][..., lasting].reshape(-1, int(np.sum(lasting)))
    claimed, n = known.covariance_of(robot)[np.ix_(lasting, lasting)], len(known.covariance)
    by_priors, prior, scales = fit.rows.prior.times(fit.root), fit.rows.prior, fit.unknowns.scales
    left = scales[:, None] * (fit.root @ by_priors.T)  # of the covariance, left @ left.T is what priors leave open
    claimed[:n, :n] -= fit.interval_factor**2 * left @ left.T
    noise = claimed.copy()
    noise[:n, :n] -= (fit.interval_factor**2 - 1.0) * (fit.statistics.covariance - left @ left.T)
    by_prior = columns[:, :n] @ (left @ prior.times(np.eye(n)))
    points = linear.positions[:, located].reshape(-1, 3)
    variances = [float(np.sum((columns @ covariance) * columns)) / len(points) for covariance in (noise, claimed)]
    return points, *variances, dict(zip(fit.free_names, by_prior.T, strict=True))


def apart(robot: calib.Robot, data: Measurements, how: str, rng: np.random.Generator) -> FloatArray:
    """Return mean squares, (3,) [m^2]: how far predictions are apart, as claimed without blocks left out, and with."""
    fits = [calib.fit(robot, data[half], terms=WAYS[how]) for half in halves(robot, data, how, rng)]
    (points, *variances, by_prior), (others, *more, by_other) = (predicted(fit, data) for fit in fits)
    nothing, names = np.zeros(points.size), dict.fromkeys([*by_prior, *by_other])
    differ = sum(float(np.sum((by_prior.get(k, nothing) - by_other.get(k, nothing)) ** 2)) for k in names) / len(points)
    seen = float(np.sum((points - others) ** 2)) / len(points)
    return np.array([seen, *(a + b + differ for a, b in zip(variances, more, strict=True))])


def main() -> None:
    """Run the command line."""
    parser = of_folder(__doc__, PAGE)
    parser.add_argument("--draws", type=int, default=5, help="pairs of halves; five times as many without terms")
    options = parser.parse_args()
    rows = []
    for name, robot, data in sets(options.folder):
        for how in WAYS:
            if options.only not in f"{name} {how}":
                continue
            n_draws = options.draws * (1 if WAYS[how] else _QUICK)
            draws = [apart(robot, data, how, np.random.default_rng(k)) for k in range(n_draws)]
            seen, noise, claimed = 1e3 * np.sqrt(np.mean(draws, axis=0))
            rows.append([f"{name}, {how}", n_draws, f"{seen:.3f}", f"{seen / noise:.2f}", f"{seen / claimed:.2f}"])
            print(*rows[-1], sep=" | ", flush=True)
    if options.page:
        head = ["robot, halves", "pairs", "apart [mm]", "apart / claimed without blocks left out", "apart / as claimed"]
        written(PAGE, "halves", markdown(head, rows))


if __name__ == "__main__":
    main()

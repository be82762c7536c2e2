"""Rules by which joint terms are chosen, on simulated arms that touch sockets in three places, one of them held out.

    python tests/simulated_places.py FOLDER/mukca [N] [SEED]

prints the table of docs/theory/joint_terms.md. The arms, their places and about where their joints stood are those of
real data (docs/benchmarks.md); errors, joint values at contact and noise are simulated. Errors of origins are 0.7 times
those expected, each kind of term is there with a chance of 0.35, its size from 0.3 to 3 times what is expected, noise
0.05 to 0.2 mm. "Lacking" robots have errors besides that no term describes: each joint is off by the product of two
waves over two joints.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from public_data import PLACES, from_sockets, masses_of, mukca

import calib
from calib.core.base.threads import one_blas_thread
from calib.core.fitting.terms.candidate_terms import candidates
from calib.core.fitting.terms.term_choice import _Search
from calib.core.fitting.terms.term_trials import Trials
from calib.core.robots.terms.terms import listed_terms

KINDS = ("gain", "harmonics", "curve", "compliance", "bending")
LACKING = 3e-4  # about how far a joint is off by what no term describes [rad]


class Guessing(_Search):
    """Adds the likeliest kind alone, whatever looks like it."""

    def step(self, groups, term):
        """The groups with a term alone, where it earns its place."""
        stepped = (*groups, (term,))
        return () if self.refused(stepped) else stepped


def search(rule, fit):
    """The search by one of the rules."""
    tried = tuple(candidate for candidate in candidates(fit.robot, fit.identification.data) if not candidate.refused)
    trials = Trials(fit, tried)
    if rule == "no places left out":
        trials._partitions = trials._partitions[:1]
    return (Guessing if rule == "likeliest kind alone" else _Search)(trials, tried)


RULES = ("as it is", "likeliest kind alone", "no places left out")


def true_robot(placed, rng):
    """A robot with errors, and the kinds of terms that it has."""
    kinds = {kind: np.exp(rng.uniform(np.log(0.3), np.log(3))) for kind in KINDS if rng.random() < 0.35}
    true = placed.with_terms(listed_terms(",".join(kinds)) if kinds else ())
    family = {p.name: kind for kind in kinds for term in placed.with_terms(listed_terms(kind)).terms
              for p in term.parameters}  # fmt: skip
    sizes = [0.0 if p.placement else p.sigma_si * kinds.get(family.get(p.name, ""), 0.7) for p in true.parameters]
    return true.with_parameters(true.values + np.array(sizes) * rng.standard_normal(len(sizes))), set(kinds)


def lacking(q, rng):
    """What joints are off by that no term describes, (n, n_joints) [rad]."""
    off, n = np.zeros_like(q), q.shape[1]
    size = LACKING * np.exp(rng.uniform(np.log(0.3), np.log(3)))
    for j in range(n):
        waves = [np.sin(rng.uniform(0.5, 3) * q[:, k] + rng.uniform(0, 2 * np.pi)) for k in rng.integers(0, n, 2)]
        off[:, j] = size * rng.standard_normal() * waves[0] * waves[1]
    return off


def held_out(folder, arm, lacks, n, seed):
    """Errors in a place that was held out [mm], by rule, origins alone first; and by rule, groups added, and wrong."""
    places = PLACES[arm]
    robot, data = mukca(folder, arm, places, masses_of(arm))
    at, socket = np.array(data.setups), data.readings["tool"].details[:, 0].astype(int)
    placed = calib.fit(robot, data).placed
    pairs = [mukca(folder, arm, tuple(p for p in places if p != held), masses_of(arm)) for held in places]
    errors, counts = [], np.zeros((len(RULES), 2), dtype=int)
    for number in range(n):
        rng = np.random.default_rng([seed, number])
        true, kinds = true_robot(placed, rng)
        noise = rng.choice([0.05e-3, 0.1e-3, 0.2e-3])
        q = calib.simulate(true, data, sigma=noise, seed=rng, joint_sigma=3e-5).joints
        q = q - lacking(q, rng) if lacks else q
        for held, (pair, read) in enumerate(pairs):
            test = [q[(at == held) & (socket == k)] for k in (0, 1)]
            fit = calib.fit(pair, replace(read, joints=q[at != held]))
            row = [from_sockets(fit.robot, test)]
            for k, rule in enumerate(RULES):
                search_ = search(rule, fit)
                groups, _ = search_.chosen()
                counts[k] += len(groups), sum(not kinds & set(group) for group in groups)
                chosen = search_.of(groups)
                added = [
                    s
                    for candidate in search_.tried
                    if candidate.term in chosen.terms
                    for s in search_.entries(candidate, chosen)
                ]
                row.append(from_sockets(calib.fit(pair.with_terms(added), fit.identification.data).robot, test))
            errors.append(row)
    return np.array(errors), counts


@one_blas_thread
def main(folder, n, seed):
    """Print the table."""
    print(f"| arm | errors | origins alone | {' | '.join(RULES)} | wrong, of those added |")
    for arm in PLACES:
        for lacks in (False, True):
            errors, counts = held_out(folder, arm, lacks, n, seed)
            mean = " | ".join(f"{error:.3f}" for error in np.exp(np.mean(np.log(errors), axis=0)))
            wrong = ", ".join(f"{bad} of {added}" for added, bad in counts)
            print(f"| {arm} | {'lacking' if lacks else 'all described'} | {mean} | {wrong} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", metavar="FOLDER/mukca", type=Path, help="the real data")
    parser.add_argument("n", nargs="?", type=int, default=16, help="simulated robots of each arm, each in three places")
    parser.add_argument("seed", nargs="?", type=int, default=1)
    options = parser.parse_args()
    main(options.folder, options.n, options.seed)

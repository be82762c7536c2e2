"""Where the time goes: shares of the parts of a piece of work, by Python's profiler.

    python tests/benchmarks/where.py [--data FOLDER]

What compiled code takes counts for the function that calls it. FOLDER holds the measurements of others, as for
evaluations.py; without it, the choice of joint terms is left out.
"""

import argparse
import cProfile
import inspect
import pstats
import tempfile
from pathlib import Path

import evaluations
import numpy as np
from timing import fast

import calib
from calib.core.base.threads import one_blas_thread
from calib.core.calibrating import file_robots
from calib.core.fitting import curvature, fit, regions, solving
from calib.core.fitting.terms import term_sizes
from calib.core.judging import claim, error_budget, residual_patterns, verdict
from calib.core.robots import continuation, kinematics
from calib.core.rows import jacobian
from calib.studies import study_data
from medrue import robot_file
from medrue.workspace import target_workspace
from viz import pictures, report_page, scene, svg, viewer_page

SIGMA = 4e-5
ROWS = 20_000


def shares(work, parts):
    """Share of each part in the time of some work, functions by name; of what it calls, too."""
    one_blas_thread(work)()  # imports, and what is remembered
    profile = cProfile.Profile()
    profile.runcall(one_blas_thread(work))
    stats = pstats.Stats(profile)
    taken = {key: cumulative for key, (_, _, _, cumulative, _) in stats.stats.items()}
    for name, function in parts.items():
        code = inspect.unwrap(getattr(function, "func", function)).__code__
        yield name, taken.get((code.co_filename, code.co_firstlineno, code.co_name), 0.0) / stats.total_tt


def step(name):
    """What every step of a fit needs: loops closed and derivatives, 420 poses."""
    robot, some = evaluations.example(name)
    q = np.tile(some.joints, (420 // len(some) + 1, 1))[:420]
    seed = robot.assemble(q).passive
    moved = robot.with_parameters(robot.values + 1e-5)

    def both():
        for _ in range(20):
            jacobian.linearise(moved, moved.assemble(q, seed=seed))

    return both


def saved(robot, data, folder):
    """A fit with the files of its result but pages, which are looked at alone."""
    calib.fit(robot, data).save(folder / "out", pages=False, force=True)


def works(folder):
    """What is looked at: name, work, and its parts."""
    closing = {
        "closing": continuation.newton,
        "poses of joints in both": kinematics.sweep,
        "derivatives": jacobian.relative_motion,
        "linear systems in both": np.linalg.solve,
    }
    for name, shown in (("medrue", "MedRUE"), ("stewart", "Stewart")):
        yield f"closing and derivatives, {shown}", step(name), closing
        quick = {**closing, "poses of joints in both": kinematics.compiled_sweep}
        yield f"closing and derivatives, {shown}, with `fast`", fast(step(name)), quick
    medrue, q = calib.load(robot_file()), np.array(target_workspace().q)[::5]
    draws = {
        "minima": solving.solve_from,
        "uncertainty": solving.uncertainty_at,
        "readings simulated": study_data.SimulatedDraws.draw,
    }
    yield "a draw of a study, MedRUE, with `fast`", fast(lambda: calib.study(medrue, q, draws=100, sigma=SIGMA)), draws
    fits = {
        "minima": fit.minimum_of,
        "second order of intervals": curvature.mean_square_beyond_linear,
        "first order of them": solving.uncertainty_at,
        "robots of files": file_robots.with_files,
        "verdict": verdict.judge,
        "patterns of residuals in it": residual_patterns.patterns,
        "claim in it": claim.claim_of,
    }
    if folder:
        robot, data = evaluations.ur10(folder / "ur10_tracker", 1000)
        parts = {"sizes of terms": term_sizes.size_terms, **fits}
        yield "`--terms auto`, UR10, 1000 poses", lambda: calib.fit(robot, data, terms="auto").to_dict(), parts
    with tempfile.TemporaryDirectory() as name:
        arm = calib.load(evaluations.EXAMPLES / "arm.yaml")
        many = calib.simulate(arm, arm.sample(ROWS, seed=1), SIGMA, 1)
        parts = {**fits, "regions": regions.disagreeing, "error budget": error_budget.error_budget}
        yield f"a fit of {ROWS} poses of an arm, saved", lambda: saved(arm, many, Path(name)), parts
        small = calib.fit(medrue, calib.simulate(medrue, q, SIGMA, 1))
        pages = {
            "report": report_page.report_page,
            "viewer": viewer_page.scene_page,
            "scene": scene.scene_of_fit,
            "figures as SVG": svg.svg_text,
        }
        yield "pages of a fit, libraries loaded", lambda: pictures.pages(small), pages


def table(folder):
    """Lines of the table."""
    yield "| work | shares |"
    yield "|---|---|"
    for name, work, parts in works(folder):
        shown = ", ".join(
            f"{part} {share:.0%}".replace("%", " %") for part, share in shares(work, parts) if share > 0.005
        )
        yield f"| {name} | {shown} |"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder with measurements of others")
    for line in table(parser.parse_args().data):
        print(line, flush=True)

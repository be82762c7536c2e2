"""What whole commands take: processor time, and memory, from the shell's prompt to the next.

    python -m tests.benchmarks.whole_commands [--data FOLDER]

The unit is a program that imports the libraries that a fit with pages needs, and ends. Measurements are simulated, but
those of the UR10: FOLDER holds those of others, as for evaluations.py; without it, these rows are left out. The byte
code of all modules is there, and so is what numba compiles, as they are after a first run.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import calib
from calib.core.base.units import PER_SI, millimetres
from calib.core.data.measurement_files import format_measurements
from calib.core.data.table_writing import format_table
from medrue import robot_file
from medrue.workspace import target_workspace
from tests.benchmarks import many_joints
from tests.benchmarks.timing import print_table
from tests.project import EXAMPLES, ROOT

IMPORTS = ["-c", "import numpy, scipy.linalg, pinocchio, yourdfpy, matplotlib.figure"]
SOME = 10_000
MANY = 100_000
MOST = 1_000_000
COMPILE = """
import sys, calib
from calib.core.robots.acceleration import compile_kinematics
with compile_kinematics():
    calib.fit(*sys.argv[1:])
"""
MEASURE = """
import os, sys
quiet = [(os.POSIX_SPAWN_OPEN, of, os.devnull, os.O_WRONLY, 0) for of in (1, 2)]
child = os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ, file_actions=quiet)
_, status, usage = os.wait4(child, 0)
print(os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime, usage.ru_maxrss)
"""
"""A small program between this one and the command, whose memory counts as that of the command."""
PROGRAMS = {"calib": ["-m", "calib"], "medrue": ["-c", "from medrue.cli import main; main()"]}


def taken(arguments, folder):
    """Processor time [s] and peak memory [GB] of one run of Python, with one thread of linear algebra."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # what is compiled stays, as it does for users
    environment |= {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}
    measured = [sys.executable, "-S", "-c", MEASURE, sys.executable, *arguments]
    done = subprocess.run(measured, cwd=folder, env=environment, capture_output=True, text=True, check=True)
    code, seconds, memory = done.stdout.split()
    assert code == "0", arguments
    return float(seconds), float(memory) / 1e6


def some_rows(source, path, n=30):
    """Write every so many of a file's rows, n in all."""
    lines = source.read_text().splitlines(keepends=True)
    head = next(k for k, line in enumerate(lines) if not line.startswith("#")) + 1
    step = max((len(lines) - head) // n, 1)
    path.write_text("".join(lines[:head] + lines[head::step][:n]))


def joint_columns(robot, q):
    """Columns of joint values (n, n_actuated) [m or rad] in degrees and mm."""
    units = {"angle": "deg", "length": "mm"}
    for name, values in zip(robot.joint_names, q.T, strict=True):
        dimension = robot.mechanism.dimensions[name]
        yield f"{name} [{units[dimension]}]", list(values * PER_SI[dimension][units[dimension]])


def written(path, robot, parts):
    """Write joint values part by part."""
    with path.open("w") as file:
        for k, q in enumerate(parts):
            text = format_table(list(joint_columns(robot, q)))
            file.write(text if k == 0 else text.partition("\n")[2])


def prepared(folder, data):
    """Write the inputs, and return the commands by name."""
    robots = {"arm": EXAMPLES / "arm.yaml", "five-bar": EXAMPLES / "five_bar.yaml", "MedRUE": Path(robot_file())}
    medrue, rng = calib.load(robots["MedRUE"]), np.random.default_rng(0)
    q = np.array(target_workspace().q)
    target = medrue.target_names[0]
    for where, poses in (("", q[rng.integers(len(q), size=1000)]), (" anywhere", medrue.sample(1000, seed=3))):
        places = millimetres(medrue.positions(poses)[:, 0])
        columns = [(f"{target}_{axis} [mm]", list(column)) for axis, column in zip("xyz", places.T, strict=True)]
        (folder / f"targets{where}.csv").write_text(format_table(columns))
    for n in (MANY, MOST):
        spread = 0.03 * medrue.mechanism.joint_scale
        parts = (
            q[rng.integers(len(q), size=MANY)] + spread * rng.standard_normal((MANY, q.shape[1]))
            for _ in range(n // MANY)
        )
        written(folder / f"candidates-{n}.csv", medrue, parts)
    commands = {"`calib --version`": ["--version"]}
    for pages in (False, True):
        for name, path in robots.items():
            some_rows(EXAMPLES / f"{path.stem}_simulated.csv", folder / f"{name}.csv")
            arguments = ["fit", str(path), f"{name}.csv", "--out", f"{name}-{pages}", *["--no-pages"] * (not pages)]
            commands[f"`calib fit`, 30 poses, {name}{', with pages' * pages}"] = arguments
    written(folder / "paged.csv", arm := calib.load(robots["arm"]), [arm.sample(1000, seed=4)])
    read = ["simulate", str(robots["arm"]), "paged.csv", "--seed", "2", "--out", "paged-read.csv"]
    taken(["-m", "calib", *read], folder)
    paged = ["fit", str(robots["arm"]), "paged-read.csv", "--out", "paged"]
    commands["`calib fit`, 1000 poses, arm, with pages"] = paged
    for n in (6, 18):
        own = folder / f"chain-{n}"
        own.mkdir()
        chain = calib.load(many_joints.write_chain(own, n, np.random.default_rng(7)))
        read = format_measurements(chain, many_joints.measured(chain, 400, np.random.default_rng(3)), ())
        (own / "read.csv").write_text(read)
        fit = ["fit", f"chain-{n}/chain.yaml", f"chain-{n}/read.csv", "--terms", "auto", "--no-pages"]
        commands[f"`calib fit --terms auto`, 400 poses, chain of {n} joints"] = [*fit, "--out", f"chain-{n}-fit"]
    if data:
        (folder / "robot.urdf").write_bytes((data / "ur10_tracker" / "robot.urdf").read_bytes())
        (folder / "ur10.yaml").write_bytes((EXAMPLES / "ur10_tracker.yaml").read_bytes())
        some_rows(data / "ur10_tracker" / "grid.csv", folder / "ur10.csv", 300)
        for pages in (False, True):
            arguments = ["fit", "ur10.yaml", "ur10.csv", "--terms", "auto", "--out", f"ur10-{pages}"]
            name = f"`calib fit --terms auto`, 300 poses, UR10{', with pages' * pages}"
            commands[name] = [*arguments, *["--no-pages"] * (not pages)]
    commands["`calib check` without data, MedRUE"] = ["check", str(robots["MedRUE"])]
    for where in ("", " anywhere"):
        commands[f"`calib solve`, 1000 targets{where}, MedRUE"] = [
            *("solve", str(robots["MedRUE"]), f"targets{where}.csv"),
            *("--skip-unreachable", "--out", "solved.csv"),
        ]
    sample = ("sample", str(robots["MedRUE"]), "--out", "sampled.csv", "--count")
    taken(["-m", "calib", *sample, str(SOME)], folder)
    (folder / "program.csv").write_bytes((folder / "sampled.csv").read_bytes())
    commands[f"`calib sample`, {MANY} poses, MedRUE"] = [*sample, str(MANY)]
    commands[f"`calib compensate`, {SOME} poses, MedRUE"] = [
        *("compensate", "MedRUE-False", "program.csv"),
        *("--skip-unreachable", "--out", "compensated.csv"),
    ]
    for n in (MANY, MOST):
        commands[f"`calib select`, 84 of {n} poses, MedRUE"] = [
            *("select", str(robots["MedRUE"]), f"candidates-{n}.csv", "--count", "84", "--out", "chosen.csv")
        ]
    for name, counts in (("arm", (MANY, MOST)), ("MedRUE", (MANY,))):
        robot = calib.load(robots[name])
        for n in counts:
            poses = folder / f"candidates-{n}.csv"
            if name == "arm":
                poses = folder / f"arm-{n}.csv"
                written(poses, robot, (robot.sample(MANY, seed=k) for k in range(n // MANY)))
            simulate = ["simulate", str(robots[name]), str(poses), "--seed", "2", "--out", f"{name}-read-{n}.csv"]
            taken(["-m", "calib", *simulate], folder)
            fit = ["fit", str(robots[name]), f"{name}-read-{n}.csv", "--no-pages", "--out", f"{name}-many"]
            commands[f"`calib fit`, {n} poses, {name}"] = fit
        some_rows(folder / f"{name}-read-{MANY}.csv", folder / f"{name}-some.csv")
        taken(["-c", COMPILE, str(robots[name]), f"{name}-some.csv"], folder)
    for command in ("study", "experiment"):
        commands[f"`medrue {command} --quick`"] = [command, "--quick", "--jobs", "1", "--out", command]
    return commands


def table(data, rounds):
    """Lines of the table: ratio to the unit, seconds and memory of this machine, the least of some rounds."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        commands = prepared(folder, data)
        taken(["-m", "compileall", "-q", *(str(ROOT / package) for package in ("calib", "viz", "medrue"))], folder)
        times, sizes = {None: []} | {command: [] for command in commands}, {}
        for turn in range(rounds):
            for command in times:
                if turn == 0 or command is None or (str(MANY) not in command and "medrue" not in command):
                    program = [] if command is None else PROGRAMS[command[1:].split()[0]]
                    arguments = commands.get(command, IMPORTS)
                    times[command].append(taken([*program, *arguments], folder))
                    if arguments[0] == "fit":
                        written = (folder / arguments[arguments.index("--out") + 1]).rglob("*")
                        sizes[command] = sum(file.stat().st_size for file in written)
    unit = min(times.pop(None))[0]
    yield "| command | over importing the libraries | processor time | memory | files |"
    yield "|---|---:|---:|---:|---:|"
    for command, runs in times.items():
        seconds, memory = min(runs)
        shown = f"{memory:.1f} GB" if str(MANY) in command else ""
        files = f"{float(f'{sizes[command] / 1e6:.2g}'):g} MB" if command in sizes else ""
        yield f"| {command} | {seconds / unit:.1f} | {seconds:.1f} s | {shown} | {files} |"


if __name__ == "__main__":
    print_table(__doc__, table, 5)

"""Problems written for codes, codes run, and their answers scored with readings that they have not seen."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.optimize import least_squares

import calib

from .codes import CODES, HERE, OURS, PLACED, Code
from .data_set import DataSet, Rows, Split

sys.path.insert(0, str(HERE))  # what codes share among each other imports as they do
from urdf_chain import Chain, placed

LIMIT = 300  # seconds of processor time that a code may take for one problem
_CHAIN = """\
urdf: robot.urdf
name_mot: [{joints}]
base: {{frame: {base}}}
targets: {{point: {{frame: {link}, position: unknown}}}}
parametrisation: [{{origin: all, components: [x, y, z], sigma: 1 mm}}]
"""


def written(data: DataSet, urdf: Path, split: Split, folder: Path) -> None:
    """Write a problem as `codes/exchange.py` says."""
    robot = ElementTree.parse(urdf)
    for link in robot.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)  # meshes lie elsewhere, and no code needs them
    robot.write(folder / "robot.urdf")
    _write_mdh(data, folder)
    poses = Chain(urdf, data.base, data.link, list(data.joints)).poses(split.train.q)
    point = np.array(data.point)
    T, p = (np.eye(4), point) if data.spacing else placed(poses, split.train.read, point, data.point_sigma)
    names = ("joints", "base", "link", "point", "point_sigma", "length_sigma", "angle_sigma", "spacing")
    told = {name: getattr(data, name) for name in names} | {"T_measured_base": T.tolist(), "p_link_point": p.tolist()}
    (folder / "problem.json").write_text(json.dumps(told))
    read = ["place", "socket"] if data.spacing else ["x", "y", "z"]
    train = np.hstack([split.train.q, split.train.read])
    for name, head, table in (("train", [*data.joints, *read], train), ("unseen", data.joints, split.unseen.q)):
        np.savetxt(folder / f"{name}.csv", table, "%.17g", ",", header=",".join(head), comments="")


def _write_mdh(data: DataSet, folder: Path) -> None:
    text = _CHAIN.format(joints=", ".join(data.joints), base=data.base, link=data.link)
    (folder / "chain.yaml").write_text(text)
    try:
        calib.export(calib.load(folder / "chain.yaml"), "mdh", folder / "robot_mdh.csv")
    except calib.CalibrationError:
        (folder / "robot_mdh.csv").unlink(missing_ok=True)


def errors_of(data: DataSet, unseen: Rows, points: np.ndarray) -> np.ndarray:
    """How far off predictions are, (n,) [m]; those of sockets from two points as far apart, laid through them."""
    if data.spacing is None:
        return np.linalg.norm(points - unseen.read, axis=1)
    means = [points[unseen.read[:, 1] == hole].mean(axis=0) for hole in (0, 1)]

    def misses(x: np.ndarray) -> np.ndarray:
        line = np.array([np.cos(x[3]) * np.cos(x[4]), np.sin(x[3]) * np.cos(x[4]), np.sin(x[4])])
        return points - x[:3] - (unseen.read[:, 1:] - 0.5) * data.spacing * line

    line = means[1] - means[0]
    start = [*sum(means) / 2, np.arctan2(line[1], line[0]), np.arcsin(line[2] / np.linalg.norm(line))]
    return np.linalg.norm(misses(least_squares(lambda x: misses(x).ravel(), start).x), axis=1)


def run(code: Code, folder: Path, environments: Path | None) -> dict[str, object]:
    """Run a code on a written problem: its answer with the costs of the whole process; or `failed`, and why.

    Each runs in a process of its own, with one thread.
    """
    python = Path(sys.executable)
    if code.requires:
        python = Path(environments or "-", code.key, "bin", "python")
        if not python.is_file():
            return {"failed": f"not installed ({' '.join(code.requires)})"}
    answer = folder / "answer.json"
    answer.unlink(missing_ok=True)
    options = [code.option] if code.option else []
    command = [str(python), str(HERE / code.script), str(folder), str(answer), *options]
    before, started = os.times(), time.perf_counter()
    own = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "agg"}
    done = subprocess.run(command, capture_output=True, text=True, env=own, check=False, preexec_fn=_limited)
    after = os.times()
    if done.returncode == -signal.SIGXCPU:
        return {"failed": f"took more than {LIMIT} s of processor time"}
    if not answer.is_file():
        last = [line for line in done.stderr.splitlines() if line.strip()]
        return {"failed": last[-1].replace(f"{folder}/", "") if last else f"ended with {done.returncode} and no word"}
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return json.loads(answer.read_text()) | {"command_seconds": cpu, "wall_seconds": time.perf_counter() - started}


def results(
    data: DataSet, here: Path, codes: Sequence[Code] = CODES, environments: Path | None = None
) -> Iterator[list[dict[str, object]]]:
    """Run codes on all splits; after each, yield a dictionary for each code, with errors [m] of all unseen rows."""
    for split in data.splits(here):
        found = []
        with tempfile.TemporaryDirectory() as name:
            written(data, here / data.urdf, split, Path(name))
            for code in codes:
                one = run(code, Path(name), environments)
                one |= {"data": data.name, "kind": split.kind, "split": split.words, "code": code.name}
                one |= {"n_train": len(split.train), "n_unseen": len(split.unseen)}
                points = one.pop("points", None)
                if points is not None:
                    one["errors"] = errors_of(data, split.unseen, np.array(points)).tolist()
                found.append(one)
                print(f"{data.name}, {split.words}, {code.name}: {_said(one)}", flush=True)
        yield found


def _limited() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (LIMIT, LIMIT + 10))


def _said(one: dict[str, object]) -> str:
    return f"failed: {one['failed']}" if "failed" in one else f"{1e3 * rms(one):.4f} mm, {one['command_seconds']:.1f} s"


def rms(one: dict[str, object]) -> float:
    """Root mean square error of unseen rows [m]."""
    return float(np.sqrt(np.mean(np.square(one["errors"]))))


def summary(found: Sequence[dict[str, object]]) -> list[dict[str, object]]:
    """What the page needs of results: RMS, largest error, costs, and how each code compares with this project's."""
    rows = []
    for one in found:
        same = [o for o in found if (o["data"], o["split"]) == (one["data"], one["split"]) and "errors" in o]
        row = {key: value for key, value in one.items() if key != "errors"}
        if "errors" in one:
            row |= {"rms": rms(one), "max": max(one["errors"])}
            ours, nominal = (next((o for o in same if o["code"] == name), None) for name in (OURS, PLACED))
            if ours is not None and one["code"] not in (OURS, PLACED):
                row["compared"] = compared(ours["errors"], one["errors"])
            if one.get("verdict") and nominal is not None and one.get("claimed_rms"):
                good = row["rms"] <= 1.25 * one["claimed_rms"] and row["rms"] < rms(nominal)
                row["verdict_right"] = (one["verdict"] == "PASS") == good
        rows.append(row)
    return rows


def compared(ours: Sequence[float], theirs: Sequence[float]) -> str:
    """Whether ours predicts the same rows `better`, `worse`, or neither (`tie`): Student's t of squared errors, paired.

    Rows that follow each other in a file are no independent ones, so a difference counts only from a chance of 1 in
    1000, and from 1 % of the RMS.
    """
    change = np.square(theirs) - np.square(ours)
    spread = np.std(change, ddof=1) / np.sqrt(len(change))
    apart = abs(np.mean(change)) > 0.02 * np.mean(np.square(ours))
    if not apart or abs(np.mean(change)) < 3.3 * spread:
        return "tie"
    return "better" if np.mean(change) > 0 else "worse"

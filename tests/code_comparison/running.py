"""Problems written for codes, codes run, and their answers scored with readings that they have not seen."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import scipy

from .codes import CODES, HERE, OURS, PLACED, Code
from .data_set import DataSet

LIMIT = 300  # seconds of processor time that a code may take for one problem


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
    limited = ["sh", "-c", f'ulimit -St {LIMIT}; exec "$@"', "sh"]  # no `preexec_fn`: it forks with all that is loaded
    command = [*limited, str(python), str(HERE / code.script), str(folder), str(answer), *options]
    before = os.times()
    own = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "agg"}
    done = subprocess.run(command, capture_output=True, text=True, env=own, check=False)
    after = os.times()
    if done.returncode == -signal.SIGXCPU:
        return {"failed": f"took more than {LIMIT} s of processor time"}
    if not answer.is_file():
        last = [line for line in done.stderr.splitlines() if line.strip()]
        return {"failed": last[-1].replace(f"{folder}/", "") if last else f"ended with {done.returncode} and no word"}
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return json.loads(answer.read_text()) | {"command_seconds": cpu}


def results(
    data: DataSet,
    here: Path,
    codes: Sequence[Code] = CODES,
    environments: Path | None = None,
    only: Sequence[str] = ("",),
) -> Iterator[list[dict[str, object]]]:
    """Run codes on splits; after each, yield a dictionary for each code, with errors [m, or px] of all unseen rows."""
    for split in data.splits(here):
        if not any(word.strip() in f"{data.name}: {split.words}" for word in only):
            continue
        answers = []
        with tempfile.TemporaryDirectory() as name:
            data.write(here, split, Path(name))
            for code in (code for code in codes if code.problem == data.problem):
                answer = run(code, Path(name), environments)
                answer |= {"data": data.name, "split": split.words, "code": code.name, "problem": data.problem}
                answer |= {"chance": data.chance, "n_train": len(split.train), "n_unseen": len(split.unseen)}
                points = answer.pop("points", None)
                if points is not None:
                    answer["errors"] = data.errors(split.unseen, np.array(points)).tolist()
                answers.append(answer)
                print(f"{data.name}, {split.words}, {code.name}: {_said(answer, *data.unit)}", flush=True)
        yield answers


def _said(answer: dict[str, object], unit: str, scale: float) -> str:
    told = f"{answer.get('command_seconds', 0):.1f} s"
    return f"failed: {answer['failed']}" if "failed" in answer else f"{scale * rms(answer):.4f} {unit}, {told}"


def rms(answer: dict[str, object]) -> float:
    """Root mean square error of unseen rows [m, or px]."""
    return float(np.sqrt(np.mean(np.square(answer["errors"]))))


def summary(answers: Sequence[dict[str, object]]) -> list[dict[str, object]]:
    """What the page needs of results: RMS, costs, and how each code compares with this project."""
    rows = []
    for answer in answers:
        same = [o for o in answers if (o["data"], o["split"]) == (answer["data"], answer["split"]) and "errors" in o]
        row = {key: value for key, value in answer.items() if key != "errors"}
        if "errors" in answer:
            row["rms"] = rms(answer)
            own = OURS[answer.get("problem", "arm")]
            ours, nominal = (next((o for o in same if o["code"] == name), None) for name in (own, PLACED))
            if ours is not None and answer["code"] not in (own, PLACED):
                row["compared"] = compared(ours["errors"], answer["errors"], answer.get("chance", DataSet.chance))
            if answer.get("verdict") and answer.get("claimed_rms"):
                good = row["rms"] <= 1.25 * answer["claimed_rms"] and (nominal is None or row["rms"] < rms(nominal))
                row["verdict_right"] = (answer["verdict"] == "PASS") == good
        rows.append(row)
    return rows


def compared(ours: Sequence[float], theirs: Sequence[float], chance: float) -> str:
    """Whether ours predicts the same rows `better`, `worse`, or neither (`tie`): Student's t of squared errors, paired.

    A difference counts only if it comes by no more than this chance, and from 1 % of the RMS.
    """
    change = np.square(theirs) - np.square(ours)
    spread = np.std(change, ddof=1) / np.sqrt(len(change))
    apart = abs(np.mean(change)) > 0.02 * np.mean(np.square(ours))
    if not apart or abs(np.mean(change)) < scipy.special.stdtrit(len(change) - 1, 1 - chance / 2) * spread:
        return "tie"
    return "better" if np.mean(change) > 0 else "worse"

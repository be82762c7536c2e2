"""The command line: run codes on data, keep the results, write the page from them."""

import argparse
import json
import platform
import shutil
import subprocess
import sys
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import Any

from . import __doc__ as about
from .codes import CODES, Code
from .data_set import DataSet, MissingDataError
from .data_sets import DATA_SETS
from .page import written
from .running import results, summary

KEPT = Path("out", "code_comparison.json")


def main(given: Sequence[str] | None = None, sets: Sequence[DataSet] = DATA_SETS, codes: Sequence[Code] = CODES) -> int:
    """Run the command line, on other data sets and codes where a program asks for them."""
    parser = argparse.ArgumentParser(prog="python -m tests.code_comparison", description=about.splitlines()[0])
    parser.add_argument(
        "folder", metavar="FOLDER", type=Path, nargs="?", help="a folder for each data set; none: no run"
    )
    parser.add_argument(
        "--environments", metavar="FOLDER", type=Path, help="a virtual environment for each other package"
    )
    parser.add_argument("--install", action="store_true", help="make environments that are missing, by pip")
    parser.add_argument("--only", default="", metavar="WORDS", help="splits, such as Motoman or 'UR10: low,Franka'")
    parser.add_argument("--codes", default="", metavar="WORDS", help="codes, such as FIGAROH,GTSAM")
    parser.add_argument("--results", metavar="FILE", type=Path, default=KEPT, help="where results are kept")
    parser.add_argument("--page", metavar="FILE", type=Path, help="the page to write them into")
    options = parser.parse_args(given)
    told: dict[str, Any] = json.loads(options.results.read_text()) if options.results.is_file() else {"rows": []}
    if options.folder is not None:
        there, missing = [], []
        for data in sets:
            if any(word.partition(":")[0].strip() in data.name for word in options.only.split(",")):
                try:
                    there.append((data, data.checked(options.folder)))
                except MissingDataError as error:
                    missing.append(str(error))
        for line in missing:
            print(f"left out: {line}", file=sys.stderr)
        if not there:
            print("no data; nothing to do", file=sys.stderr)
            return 2
        chosen = [code for code in codes if any(word.strip() in code.name for word in options.codes.split(","))]
        if not chosen:
            print(
                f"no code has {options.codes!r} in its name: {', '.join(code.name for code in codes)}", file=sys.stderr
            )
            return 2
        if options.install and options.environments:
            _installed(chosen, options.environments)
        for data, here in there:
            for new in results(data, here, chosen, options.environments, options.only.split(",")):
                told = _joined(told, new, sets, codes)
                options.results.parent.mkdir(parents=True, exist_ok=True)
                options.results.write_text(json.dumps(told) + "\n", encoding="utf-8")
    if not told["rows"]:
        print(f"{options.results} has no results; name a folder of data", file=sys.stderr)
        return 2
    if options.page is not None:
        summarised = {**told, "rows": summary(told["rows"]), "versions": _versions(told["rows"])}
        written(options.page, summarised, sets)
    return 0


def _joined(
    told: dict[str, Any], new: list[dict[str, Any]], sets: Sequence[DataSet], codes: Sequence[Code]
) -> dict[str, Any]:
    """Results with new ones in place of those of the same code and rows, in the order of data sets and codes."""
    machine = f"{_processor()}, one thread for each code, Python {platform.python_version()}, {date.today():%B %Y}"
    new = [row | {"errors": [float(f"{e:.4g}") for e in row["errors"]]} if "errors" in row else row for row in new]
    new = [row | {"machine": machine} for row in new]
    done = {(row["data"], row["split"], row["code"]) for row in new}
    rows = [row for row in told["rows"] if (row["data"], row["split"], row["code"]) not in done] + new
    orders = [[entry.name for entry in ordered] for ordered in (sets, codes)]
    at = [{name: order.index(name) for name in order} for order in orders]
    splits = {split: k for k, split in enumerate(dict.fromkeys((row["data"], row["split"]) for row in rows))}
    rows.sort(key=lambda o: (at[0].get(o["data"], 99), splits[o["data"], o["split"]], at[1].get(o["code"], 99)))
    return {"rows": rows}


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def _versions(rows: Sequence[dict[str, Any]]) -> list[str]:
    return sorted({row["package"].partition(" (")[0] for row in rows if row.get("package")})


def _installed(codes: Sequence[Code], environments: Path) -> None:
    """Make the environments that are missing; one that pip cannot fill goes away, and its code is not installed."""
    for code in codes:
        here = environments / code.key
        if code.requires and not here.exists():
            subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(here)], check=True)
            python = str(here / "bin" / "python")
            pip = [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", *code.requires]
            if subprocess.run(pip, check=False).returncode:
                shutil.rmtree(here)


if __name__ == "__main__":
    sys.exit(main())

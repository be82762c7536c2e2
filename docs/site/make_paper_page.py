"""Put the results of `medrue poses`, `study`, `experiment` and `touch` into the page docs/paper.md.

    medrue poses --out out/poses.csv --json out/poses.json
    medrue study --out out/study
    medrue experiment --out out/experiment
    medrue touch --out out/touch
    python docs/site/make_paper_page.py out/poses.json out/study out/experiment out/touch

The page has places `<!-- begin study/table2.csv -->` ... `<!-- end -->`; what is between them is replaced. A CSV
becomes a table without what `LEFT_OUT` names, `poses.json` a table of where the poses are. Figures of the page are
copied to docs/figures/paper.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import shutil
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parents[1]
PAGE = DOCS / "paper.md"
FIGURES = DOCS / "figures" / "paper"
LEFT_OUT = {
    "study/table1.csv": {"unit", "identified without noise", "scatter", "paper: without noise", "redundant", "yes"},
    "study/table2.csv": {"standard error"},
    "experiment/table3.csv": {"unit", "identified - actual", "redundant", "yes"},
    "experiment/table4.csv": {"standard error"},
    "experiment/table5.csv": {"both sides"},
    "experiment/pose_count.csv": {"either side", "standard error", "RMS y", "RMS z"},
    "experiment/extended.csv": {"q3.", "q5.", "D1.", "D2.", "beta.", "slide."},
    "touch/world.csv": {"spread", "std"},
    "touch/shape.csv": {"spread", "std"},
    "touch/methods.csv": {"cannot see"},
}
"""Words of columns' headers, and of a row's first or last cell, that the page does without."""
_PLACE = re.compile(r"(<!-- begin (?P<source>\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


def table(path: Path, left_out: Collection[str] = ()) -> str:
    """Return a CSV file as a Markdown table, without the columns and rows that have a word of `left_out`."""
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    head, *rows = list(csv.reader(lines))
    kept = [k for k, name in enumerate(head) if not any(word in name for word in left_out)]
    rows = [row for row in rows if not any(word in cell for word in left_out for cell in (row[0], row[-1]))]
    text = [f"| {' | '.join(head[k] for k in kept)} |", "|---" + "|---:" * (len(kept) - 1) + "|"]
    text += [f"| {' | '.join(_cell(row[k]) for k in kept)} |" for row in rows]
    return "\n".join(text) + "\n"


def workspace(facts: Mapping[str, Any]) -> str:
    """Return what `medrue poses --json` says as a Markdown table."""
    start, end = (", ".join(f"{c:g}" for c in facts[f"axis_of_the_leg_{end}_mm"]) for end in ("from", "to"))
    x, angles, q1, tilt = (
        facts[name]
        for name in (
            "positions_along_x_mm",
            "positions_from_y_towards_z_deg",
            "q1_mm",
            "probe_tilt_mean_and_largest_deg",
        )
    )
    stations, directions = facts["different_x_and_angles"]
    rows = {
        "axis of the leg": f"from ({start}) to ({end}) mm in the world",
        "radius": f"{facts['radius_mm']:g} mm",
        "positions": f"{facts['poses']}: {stations} from x = {x[0]:.1f} to {x[1]:.1f} mm, times {directions} around the"
        f" axis from {angles[0]:.0f}° to {angles[1]:.0f}° (from +y towards +z)",
        "tilt of the probe from the shortest line to the axis": f"mean {tilt[0]:.1f}°, largest {tilt[1]:.1f}°",
        "stroke used": f"q1 from {q1[0]:.1f} to {q1[1]:.1f} mm, of 700 mm",
        "nearest to a singular pose (0)": "smallest singular value of the loops"
        f" {facts['smallest_singular_value_of_the_loops']:.3f}, smallest sine between two links"
        f" {facts['smallest_sine_between_links']:.3f}",
    }
    return "| what | value |\n|---|---|\n" + "".join(f"| {name} | {value} |\n" for name, value in rows.items())


def filled(page: str, sources: dict[str, Path]) -> str:
    """Return the page with every place filled."""

    def content(match: re.Match[str]) -> str:
        study, _, name = match["source"].partition("/")
        if study == "poses.json":
            result = workspace(json.loads(sources["poses"].read_text(encoding="utf-8")))
        else:
            result = table(sources[study] / name, LEFT_OUT.get(match["source"], ()))
        return f"{match[1]}\n{result}\n{match[3]}"

    return _PLACE.sub(content, page)


def _cell(text: str) -> str:
    try:
        number = float(text)
    except ValueError:
        return text.strip()
    if number == int(number) and "." not in text:
        return text
    digits = 3 if abs(number) >= 1 else 4
    return f"{number:.{digits}f}"


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    for name in ("poses", "study", "experiment", "touch"):
        parser.add_argument(name, type=Path, help=f"what `medrue {name}` wrote")
    sources: dict[str, Path] = vars(parser.parse_args())
    page = filled(PAGE.read_text(encoding="utf-8"), sources)
    PAGE.write_text(page, encoding="utf-8")
    FIGURES.mkdir(parents=True, exist_ok=True)
    for study, name in re.findall(r"\]\(figures/paper/(\w+?)-([\w.]+)\)", page):
        shutil.copyfile(sources[study] / name, FIGURES / f"{study}-{name}")
    print(f"{PAGE} written")


if __name__ == "__main__":
    main()

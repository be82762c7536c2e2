"""Put the results of `medrue study` and `medrue experiment` into the page docs/paper.md.

    medrue study --out out/study
    medrue experiment --out out/experiment
    python docs/site/make_paper_page.py out/study out/experiment

The page has places `<!-- begin study/table2.csv -->` ... `<!-- end -->`; what is between them is replaced. A CSV
becomes a table, `findings` the list of what a study shows. Figures of the page are copied to docs/figures/paper.
"""

from __future__ import annotations

import csv
import html
import re
import shutil
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1]
PAGE = DOCS / "paper.md"
FIGURES = DOCS / "figures" / "paper"
_PLACE = re.compile(r"(<!-- begin (?P<source>\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


def table(path: Path) -> str:
    """Return a CSV file as a Markdown table."""
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    head, *rows = list(csv.reader(lines))
    text = [f"| {' | '.join(head)} |", "|---" + "|---:" * (len(head) - 1) + "|"]
    text += [f"| {' | '.join(_cell(cell) for cell in row)} |" for row in rows]
    return "\n".join(text) + "\n"


def findings(path: Path) -> str:
    """Return the list of findings of a study's page."""
    first = re.search(r"<ul>(.*?)</ul>", path.read_text(encoding="utf-8"), re.DOTALL)
    assert first is not None
    return "".join(
        f"- {html.unescape(' '.join(item.split()))}\n" for item in re.findall(r"<li>(.*?)</li>", first[1], re.DOTALL)
    )


def filled(page: str, folders: dict[str, Path]) -> str:
    """Return the page with every place filled."""

    def content(match: re.Match[str]) -> str:
        study, _, name = match["source"].partition("/")
        found = findings(folders[study] / "index.html") if name == "findings" else table(folders[study] / name)
        return f"{match[1]}\n{found}\n{match[3]}"

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
    folders = {"study": Path(sys.argv[1]), "experiment": Path(sys.argv[2])}
    page = filled(PAGE.read_text(encoding="utf-8"), folders)
    PAGE.write_text(page, encoding="utf-8")
    FIGURES.mkdir(parents=True, exist_ok=True)
    for study, name in re.findall(r"\]\(figures/paper/(\w+?)-([\w.]+)\)", page):
        shutil.copyfile(folders[study] / name, FIGURES / f"{study}-{name}")
    print(f"{PAGE} written")


if __name__ == "__main__":
    main()

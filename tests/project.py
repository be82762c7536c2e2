"""Where things lie that tests read, and files that they write."""

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "docs" / "examples"
SHARED = ROOT.parent / "shared" / "data"
"""Real measurements by other people, which the project does not contain."""


def copied(folder: Path, source: Path, *edits: tuple[str, str], more: str = "") -> Path:
    """Write a description into a folder, its URDF where it was, with edits (old, new) and more; return its path."""
    text = re.sub(r'(?m)^urdf: "?([^"\n]+)"?', rf"urdf: {source.parent}/\1", source.read_text(), count=1)
    for old, new in edits:
        assert old in text, old
        text = text.replace(old, new)
    (folder / source.name).write_text(text + more)
    return folder / source.name


def write_table(path: Path, header: str | Iterable[str], *columns: np.ndarray | Iterable[str]) -> Path:
    """Write a table of numbers, (n,) or (n, k) with all their digits, and of words; return its path."""
    lines = [header if isinstance(header, str) else ",".join(header)]
    for row in zip(*columns, strict=True):
        cells = ([part] if isinstance(part, str) else map(repr, np.atleast_1d(part).tolist()) for part in row)
        lines.append(",".join(cell for group in cells for cell in group))
    path.write_text("\n".join(lines) + "\n")
    return path

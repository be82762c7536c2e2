"""Where things lie that tests read."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "docs" / "examples"
SHARED = ROOT.parent / "shared" / "data"
"""Real measurements by other people, which the project does not contain."""


def copied(folder: Path, source: Path, *edits: tuple[str, str], more: str = "") -> Path:
    """Write a description into a folder, its URDF where it was, with edits (old, new) and more; return its path."""
    text = source.read_text().replace("urdf: ", f"urdf: {source.parent}/", 1)
    for old, new in edits:
        assert old in text, old
        text = text.replace(old, new)
    (folder / source.name).write_text(text + more)
    return folder / source.name

"""Result folders with another verdict than their fit has."""

from pathlib import Path

from calib.core.results.saved_fit import array_file, read_array_file


def with_verdict(folder: Path, grade: str, reason: str) -> None:
    """Have a result folder say that its fit was judged so."""
    path = folder / "fit.npz"
    saved = read_array_file(path.read_bytes())
    saved["content"]["verdict"] |= {"grade": grade, "forced": False, "reasons": [reason], "grades": [grade]}
    path.write_bytes(array_file(saved))

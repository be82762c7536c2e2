"""Run the notebooks of docs/notebooks and store their outputs in them.

    python docs/site/make_notebooks.py [NOTEBOOK ...]

Outputs of cells with the tag `no-output` are not stored: a viewer takes more than a megabyte.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import nbformat
from nbclient import NotebookClient

NOTEBOOKS = Path(__file__).resolve().parents[1] / "notebooks"


def run(path: Path) -> nbformat.NotebookNode:
    """Run a notebook in its own folder and return it with outputs.

    Raises:
        nbclient.exceptions.CellExecutionError: A cell fails.
    """
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": path.parent}})
    client.execute()
    return notebook


def stored(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Strip what a stored notebook should not have: large outputs, and times and versions that differ every time."""
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        if cell.cell_type == "code" and "no-output" in cell.metadata.get("tags", []):
            cell.outputs = []
    notebook.metadata = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    return notebook


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("notebooks", metavar="NOTEBOOK", nargs="*", type=Path, help="all if none are named")
    for path in parser.parse_args().notebooks or sorted(NOTEBOOKS.glob("*.ipynb")):
        nbformat.write(stored(run(path)), path)
        print(f"{path} run")


if __name__ == "__main__":
    main()

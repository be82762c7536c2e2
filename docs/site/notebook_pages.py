"""Notebooks as pages: their text, code and outputs as Markdown and pictures, and a gallery that leads to them."""

from __future__ import annotations

import base64
from pathlib import Path

import nbformat

FOLDER = "notebooks"
NOTEBOOKS = Path(__file__).resolve().parents[1] / FOLDER
ORDER = ("medrue", "serial_arm", "five_bar", "choosing_poses")


def names() -> list[str]:
    """Notebooks in the order of the tutorials, others after them."""
    stems = [path.stem for path in sorted(NOTEBOOKS.glob("*.ipynb"))]
    return [name for name in ORDER if name in stems] + [name for name in stems if name not in ORDER]


def pages() -> dict[str, str | bytes]:
    """Path in docs/ and content of every page and picture."""
    files: dict[str, str | bytes] = {}
    cards = []
    for name in names():
        notebook = nbformat.read(NOTEBOOKS / f"{name}.ipynb", as_version=4)
        text, pictures = rendered(notebook, name)
        files[f"{FOLDER}/{name}.md"] = text
        files |= {f"{FOLDER}/{path}": content for path, content in pictures.items()}
        cards.append(_card(name, notebook, list(pictures)))
    intro = "# Notebooks\n\nFor anyone who prefers notebooks: at the end you have run a tutorial in Python.\n\n"
    files[f"{FOLDER}/index.md"] = intro + "\n".join(cards)
    return files


def rendered(notebook: nbformat.NotebookNode, name: str) -> tuple[str, dict[str, bytes]]:
    """Return a notebook as Markdown, and its pictures by their file names."""
    parts: list[str] = []
    pictures: dict[str, bytes] = {}
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            parts.append(cell.source)
            continue
        if cell.source.strip():
            parts.append(f"```python\n{cell.source}\n```")
        for output in cell.get("outputs", ()):
            parts.append(_output(output, name, pictures))
    head, _, rest = "\n\n".join(part for part in parts if part).partition("\n")
    return f"{head}\n\n[Download the notebook]({name}.ipynb)\n{rest}\n", pictures


def _output(output: nbformat.NotebookNode, name: str, pictures: dict[str, bytes]) -> str:
    if output.output_type == "stream":
        return _text(output.text)
    data = output.get("data", {})
    if "image/png" in data:
        path = f"{name}-{len(pictures) + 1}.png"
        pictures[path] = base64.b64decode(data["image/png"])
        return f"![Output]({path})"
    if "text/html" in data:
        return f'<div class="output">\n{data["text/html"]}\n</div>'
    return _text(data["text/plain"]) if "text/plain" in data else ""


def _text(text: str) -> str:
    return f'```text title="Output"\n{text.rstrip()}\n```' if text.strip() else ""


def title(notebook: nbformat.NotebookNode) -> str:
    """Return the first heading."""
    return str(notebook.cells[0].source).splitlines()[0].lstrip("# ")


def _card(name: str, notebook: nbformat.NotebookNode, pictures: list[str]) -> str:
    """Title, first sentence and last picture of a notebook."""
    told = [part for part in str(notebook.cells[0].source).split("\n\n")[1:] if part.strip()]
    sentence = " ".join(told[0].split()).partition(". ")[0].rstrip(".") + "." if told else ""
    picture = f"\n\n[![{title(notebook)}]({pictures[-1]}){{ .card }}]({name}.md)" if pictures else ""
    return f"## [{title(notebook)}]({name}.md)\n\n{sentence}{picture}\n"

"""The output folder of a study: CSV and JSON of every table, PNG and SVG of every figure, one page that shows all."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import version

from jinja2 import Environment, PackageLoader
from matplotlib.figure import Figure

from medrue.plots import figure_files
from medrue.result_tables import ResultTable


@dataclass(frozen=True, eq=False)
class NamedFigure:
    """A figure with its place in the output.

    Attributes:
        name: Name of its files, without ending.
        title: Heading.
        caption: Caption.
        figure: The figure.
    """

    name: str
    title: str
    caption: str
    figure: Figure

    @cached_property
    def files(self) -> dict[str, bytes]:
        """PNG and SVG files of the figure by name."""
        return figure_files(self.figure, self.name)

    @property
    def base64(self) -> str:
        """The PNG for embedding into a page."""
        return base64.b64encode(self.files[f"{self.name}.png"]).decode("ascii")


@dataclass(frozen=True, eq=False)
class Report:
    """All that a study has to show.

    Attributes:
        title: Heading of the page.
        introduction: Description of the simulation.
        findings: Findings in sentences.
        tables: Tables.
        figures: Figures.
        seed: Seed of everything random.
        data: Further files by name.
    """

    title: str
    introduction: str
    findings: tuple[str, ...]
    tables: Sequence[ResultTable]
    figures: Sequence[NamedFigure]
    seed: int
    data: Mapping[str, str] = field(default_factory=dict)

    def to_dict(self) -> dict[str, object]:
        """Return findings and tables as plain data for JSON."""
        return {
            "simulated": True,
            "title": self.title,
            "seed": self.seed,
            "findings": list(self.findings),
            "tables": {table.name: table.to_dict() for table in self.tables},
        }

    def files(self) -> dict[str, bytes]:
        """Return the content of the output folder by file name."""
        files: dict[str, bytes] = {}
        for table in self.tables:
            files[f"{table.name}.csv"] = table.csv().encode()
            content = {"simulated": True, "seed": self.seed, **table.to_dict()}
            files[f"{table.name}.json"] = _json(content)
        for figure in self.figures:
            files |= figure.files
        files |= {name: text.encode() for name, text in self.data.items()}
        files["index.html"] = self.page().encode()
        return files

    def page(self) -> str:
        """Return the page; it needs no other file to show everything."""
        environment = Environment(loader=PackageLoader("medrue", "templates"), autoescape=True)
        return environment.get_template("study.html").render(
            title=self.title,
            introduction=self.introduction,
            findings=self.findings,
            tables=self.tables,
            figures=self.figures,
            seed=self.seed,
            data=tuple(self.data),
            program=f"medrue {version('medrue')}",
        )


def _json(content: object) -> bytes:
    return (json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False) + "\n").encode()

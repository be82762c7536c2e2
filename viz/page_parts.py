"""Common parts of pages with plots: scripts, and the policy that allows only these.

Scripts of packages are compressed, and unpacked by the browser after the page's text has been painted.
"""

from __future__ import annotations

import base64
import functools
import gzip
import json
from importlib.resources import files
from typing import Any

from viz.charts import Chart, Charts
from viz.viewer_page import digest_of_script, folder_of_package, script_safe, viewer_scripts

_BOKEH = ("bokeh", "bokeh-api")


def chart_parts(charts: Charts, viewer: str = "") -> dict[str, Any]:
    """Return the variables of templates of pages with plots, and with the viewer's page in a frame if it is given."""
    script = script_safe((files("viz") / "templates" / "charts.js").read_text(encoding="utf-8"))
    libraries = [] if not any(charts.by_place.values()) else [(name, *_library(name)) for name in _BOKEH]
    digests = [digest_of_script(script), *(digest for _, _, digest in libraries)]
    if viewer:  # the policy of the outer page also applies in the frame
        digests += map(digest_of_script, viewer_scripts())
    return {
        "charts": charts.by_place,
        "script": script,
        "packed": [
            ("charts", pack(json.dumps(charts.to_dict(), allow_nan=False, separators=(",", ":")))),
            *((name, text) for name, text, _ in libraries),
            *([("viewer-page", pack(viewer))] if viewer else []),
        ],
        "allowed": " ".join(f"'sha256-{digest}'" for digest in digests),
        "licence": _licence(),
    }


def pack(text: str) -> str:
    """Return compressed text as base64; the same text gives the same result."""
    return base64.b64encode(gzip.compress(text.encode("utf-8"), 6, mtime=0)).decode("ascii")


def places(**charts: Chart | tuple[Chart | None, ...] | None) -> dict[str, tuple[Chart, ...]]:
    """Return plots by their part of the page."""
    return {
        name: tuple(chart for chart in (given if isinstance(given, tuple) else (given,)) if chart is not None)
        for name, given in charts.items()
    }


@functools.cache
def _library(name: str) -> tuple[str, str]:
    code = (folder_of_package("bokeh") / "server" / "static" / "js" / f"{name}.min.js").read_text(encoding="utf-8")
    return pack(code), digest_of_script(code)


@functools.cache
def _licence() -> str:
    return (folder_of_package("bokeh") / "LICENSE.txt").read_text(encoding="utf-8")

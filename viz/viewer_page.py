"""The viewer as one self-contained HTML file, which opens from disk without a server."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import os
import sys
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calib.core.base.files import write_file
from calib.core.base.version import VERSION
from viz.scene import ViewerScene
from viz.scene_data import scene_data

if TYPE_CHECKING:
    from jinja2 import Environment

_SCRIPTS = (
    "kinematics.js",
    "drive.js",
    "numbers.js",
    "table.js",
    "marks.js",
    "map.js",
    "labels.js",
    "camera.js",
    "stage.js",
    "panel.js",
    "motion.js",
    "theme.js",
    "picture.js",
    "groups.js",
    "input.js",
    "controls.js",
    "cockpit.js",
    "start.js",
)


@dataclass(frozen=True)
class ViewerPage:
    """A finished page; `html` is the whole file."""

    html: str

    def save(self, path: Path | str, *, force: bool = False) -> Path:
        """Write the page, or leave an existing file untouched.

        Args:
            path: HTML file to write.
            force: Whether to replace a file that this program did not write.

        Raises:
            InputError: The file cannot be written, or should not be replaced.
        """
        write_file(path, self.html, force=force)
        return Path(path)

    def _repr_html_(self) -> str:
        """Show the page inside a notebook cell, even with a kernel on another machine."""
        return f'<iframe srcdoc="{html.escape(self.html)}" style="width: 100%; height: 640px; border: 0"></iframe>'


def templates(**options: Any) -> Environment:
    """Return the environment of pages, which escapes all inserted text; `options` go to Jinja's `Environment`.

    Compiled templates are cached where Python caches modules.
    """
    from jinja2 import Environment, FileSystemBytecodeCache, FileSystemLoader

    folder = Path(__file__).parent / "templates"
    kept = folder / "__pycache__"
    if not sys.dont_write_bytecode:
        with suppress(OSError):
            kept.mkdir(exist_ok=True)
    cache = FileSystemBytecodeCache(str(kept), "%s.template") if os.access(kept, os.W_OK) else None
    return Environment(loader=FileSystemLoader(folder), autoescape=True, bytecode_cache=cache, **options)


def viewer_scripts() -> tuple[str, str]:
    """Return the scripts of a viewer's page: meshcat's, and its own."""
    folder = files("viz") / "templates"
    scripts = "\n".join((folder / name).read_text(encoding="utf-8").replace('"use strict";\n', "") for name in _SCRIPTS)
    return script_safe(meshcat_script()[0]), script_safe('"use strict";\n' + scripts)


def scene_page(scene: ViewerScene, *, live: bool = False, report: str = "", embedded: bool = False) -> ViewerPage:
    """Return the viewer page of a scene.

    `live`: it listens to the server that sends it. `report` is the report beside it, to link to. `embedded`: it is in a
    frame of another page, which has controls of its own.
    """
    folder = files("viz") / "templates"
    meshcat, script = viewer_scripts()
    text = (
        templates()
        .get_template("viewer.html")
        .render(
            title=scene.title,
            version=VERSION,
            live=live,
            report=report,
            embedded=embedded,
            licences=meshcat_script()[1],
            allowed=" ".join(f"'sha256-{digest_of_script(source)}'" for source in (meshcat, script)),
            meshcat=meshcat,
            style=(folder / "viewer.css").read_text(encoding="utf-8"),
            script=script,
            scene=json_in_script(scene_data(scene, live=live)),
        )
    )
    return ViewerPage(text)


def meshcat_script() -> tuple[str, str]:
    """Return meshcat's viewer (with three.js) and its licences."""
    script = folder_of_package("meshcat") / "viewer" / "dist" / "main.min.js"
    licences = script.with_name("main.min.js.LICENSE.txt")
    return script.read_text(encoding="utf-8"), licences.read_text(encoding="utf-8")


def folder_of_package(name: str) -> Path:
    """Return the folder of a required package, without importing it: that takes a second, and may bring IPython."""
    package = find_spec(name)
    assert package is not None, "it is among the requirements"
    return Path(str(package.origin)).parent


def script_safe(code: str) -> str:
    """Return code that cannot end the script element around it, with line ends as browsers read them."""
    return code.replace("\r\n", "\n").replace("\r", "\n").replace("</script", "<\\/script").replace("<!--", "<\\!--")


def digest_of_script(code: str) -> str:
    """Return the digest by which a page's Content-Security-Policy allows only this script."""
    return base64.b64encode(hashlib.sha256(code.encode("utf-8")).digest()).decode("ascii")


def json_in_script(data: object) -> str:
    """Return JSON in which no text can end the script element around it."""
    text = json.dumps(data, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    for letter in "<>&\u2028\u2029":
        text = text.replace(letter, f"\\u{ord(letter):04x}")
    return text

"""Take pictures of a result folder's pages in a real browser, for the documentation.

    python docs/site/screenshots.py DIR --out FOLDER

It needs Chromium and the extra `browser` (in a checkout: `pip install -e '.[browser]'`).
"""

from __future__ import annotations

import argparse
import io
import shutil
from pathlib import Path
from typing import Any

from calib.core.base.errors import InputError
from calib.core.base.files import write_folder

DESKTOP = {"width": 1400, "height": 900}
PHONE = {"width": 390, "height": 844}
PAPER = {"width": 688, "height": 890}
"""A window as wide as A4 between its margins, so that pages look as in print."""
_BEFORE = "document.getElementById('state-before').click()"
_DARK = "for (const id of ['dark', 'same-scale']) document.getElementById(id).click()"
_FRAMES = "document.getElementById('show-frames').click()"
_ELLIPSOIDS = "document.getElementById('show-ellipsoids').click();document.getElementById('map-block').scrollIntoView()"
_MAP = "map.html"  # of `calib view --map --html`, if it exists
PICTURES: tuple[tuple[str, str, dict[str, int], str], ...] = (
    ("viewer", "viewer.html", DESKTOP, ""),
    ("viewer-before", "viewer.html", DESKTOP, _BEFORE),
    ("viewer-frames", "viewer.html", DESKTOP, _FRAMES),
    ("viewer-dark", "viewer.html", DESKTOP, _DARK),
    ("viewer-phone", "viewer.html", PHONE, ""),
    ("report", "report.html", {"width": 1000, "height": 1300}, ""),
    ("viewer-map", _MAP, DESKTOP, _ELLIPSOIDS),
)
"""Name of the picture, page, size of the window [px], and the script to run before."""


def chromium() -> str:
    """Return the path of the system's Chromium.

    Raises:
        InputError: There is no Chromium.
    """
    for name in ("chromium", "chromium-browser", "google-chrome"):
        path = shutil.which(name)
        if path is not None:
            return path
    raise InputError("no Chromium on this computer; install the package 'chromium'")


def small(picture: bytes) -> bytes:
    """Return a PNG file with 256 colours, a third as large; no colour of the legend is lost."""
    from PIL import Image

    with Image.open(io.BytesIO(picture)) as image, io.BytesIO() as file:
        method, plain = Image.Quantize.MAXCOVERAGE, Image.Dither.NONE
        image.convert("RGB").quantize(256, method=method, kmeans=2, dither=plain).save(file, "PNG", optimize=True)
        return file.getvalue()


def take(folder: Path, views: tuple[tuple[str, str, dict[str, int], str], ...] = PICTURES) -> dict[str, bytes]:
    """Take pictures, and return PNG files by name.

    Args:
        folder: Folder of a result with its pages; map.html is optional.
        views: Entries as in `PICTURES`.

    Raises:
        InputError: A page, Chromium or playwright is missing.
    """
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        raise InputError("playwright is not installed; in a checkout: pip install -e '.[browser]'") from None
    pictures = [picture for picture in views if picture[1] != _MAP or (folder / picture[1]).is_file()]
    for _, page, _, _ in pictures:
        if not (folder / page).is_file():
            raise InputError(f"{folder}: has no {page}; give the folder that `calib fit --out` wrote")
    taken = {}
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium())
        try:
            for name, page, size, action in pictures:
                taken[f"{name}.png"] = take_one(browser, (folder / page).resolve(), size, action)
        finally:
            browser.close()
    return taken


def take_one(browser: Any, page: Path, size: dict[str, int], action: str) -> bytes:
    """Return a PNG file of a page in a browser of playwright; `size` and `action` are as in `PICTURES`."""
    tab = browser.new_page(viewport=size, reduced_motion="reduce")
    tab.goto(page.as_uri())
    if tab.query_selector("#pane, #charts"):
        tab.wait_for_selector("body[data-ready]")
    if tab.query_selector("#charts"):
        tab.evaluate("calibrationReport.all()")
    if size == PAPER:
        tab.evaluate("window.dispatchEvent(new Event('beforeprint'))")
        tab.emulate_media(media="print")
        tab.evaluate("Promise.all([...document.images].filter(({ src }) => src).map((image) => image.decode()))")
    if action:
        tab.evaluate(action)
    tab.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    picture: bytes = tab.screenshot()
    tab.close()
    return picture


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="folder of a result with its pages")
    parser.add_argument("--out", required=True, type=Path, help="folder for the PNG files")
    given = parser.parse_args()
    taken = {name: small(picture) for name, picture in take(given.folder, PICTURES).items()}
    write_folder(given.out, taken, force=True)
    print("\n".join(str(given.out / name) for name in taken))


if __name__ == "__main__":
    main()

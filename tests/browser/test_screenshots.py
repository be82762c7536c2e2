"""The command that takes the documentation's pictures."""

import subprocess
import sys

from PIL import Image
from viz_examples import medrue_fit

from viz.screenshots import PICTURES

SOME = """
from viz import screenshots
screenshots.PICTURES = [p for p in screenshots.PICTURES if p[0] in ("viewer-phone", "report")]
screenshots.command()
"""
"""The others show what the tests of the viewer show."""


def test_pictures_of_a_result_folder_are_taken(chromium_path, tmp_path, with_pages):
    medrue_fit(validation=None).save(str(tmp_path / "result"))
    arguments = [str(tmp_path / "result"), "--out", str(tmp_path / "pictures")]
    done = subprocess.run([sys.executable, "-c", SOME, *arguments], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "pictures").glob("*.png"))) == 2
    for name, _, size, _ in PICTURES[4:6]:
        with Image.open(tmp_path / "pictures" / f"{name}.png") as picture:
            assert picture.size == (size["width"], size["height"])
            assert len(picture.getcolors(1_000_000)) > 200  # something is drawn

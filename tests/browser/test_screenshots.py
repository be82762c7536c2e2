"""The command that takes the documentation's pictures."""

import subprocess
import sys

from PIL import Image
from viz_examples import medrue_fit

import viz
from viz.screenshots import PICTURES


def test_pictures_of_a_result_folder_are_taken(chromium_path, tmp_path):
    fit = medrue_fit(validation=None)
    fit.save(str(tmp_path / "result"))
    viz.page(fit.nominal, fit, mapped=20).save(tmp_path / "result" / "map.html")
    done = subprocess.run(
        [sys.executable, "-m", "viz.screenshots", str(tmp_path / "result"), "--out", str(tmp_path / "pictures")],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    for name, _, size, _ in PICTURES:
        with Image.open(tmp_path / "pictures" / f"{name}.png") as picture:
            assert picture.size == (size["width"], size["height"])
            assert len(picture.getcolors(1_000_000)) > 200  # something is drawn

"""The documentation's pictures."""

import io

import pytest
from PIL import Image

from docs.site.screenshots import PICTURES, take_one
from tests.viz.viz_examples import medrue_fit


@pytest.mark.quick(0)
def test_pictures_of_a_result_folder_are_taken(chromium, tmp_path, with_pages):
    medrue_fit(validation=None).save(str(tmp_path / "result"))
    for name, page, size, action in PICTURES:
        if name == "viewer-phone":
            taken = take_one(chromium, tmp_path / "result" / page, size, action)
            with Image.open(io.BytesIO(taken)) as picture:
                assert picture.size == (size["width"], size["height"])
                assert len(picture.getcolors(1_000_000)) > 200  # something is drawn

"""A result folder gets its two pages through the entry points, and `calib` gets its command."""

from importlib.metadata import entry_points

import pytest

from tests.viz.viz_examples import medrue_fit
from viz.pictures import figures, pages


def test_the_pages_of_a_fit():
    result = pages(medrue_fit(validation=None))
    assert set(result) == {"report.html", "viewer.html"}
    assert all(page.startswith(b"<!DOCTYPE html>") for page in result.values())


def test_the_entry_points_are_installed():
    assert {(entry.name, entry.value) for entry in entry_points(group="calib.pictures")} >= {("view", "viz.pictures")}
    assert {entry.name for entry in entry_points(group="viz.decorations")} >= {"medrue"}


def test_what_has_no_figures_is_a_mistake_of_the_caller():
    with pytest.raises(TypeError, match="no figures of int"):
        figures(3)

"""A result folder gets its two pages through the entry points, and `calib` gets its command."""

from importlib.metadata import entry_points

from viz_examples import medrue_fit

from viz.writer import write


def test_the_pages_of_a_fit():
    pages = write(medrue_fit(validation=None))
    assert set(pages) == {"report.html", "viewer.html"}
    assert all(page.startswith(b"<!DOCTYPE html>") for page in pages.values())


def test_the_entry_points_are_installed():
    assert {entry.value for entry in entry_points(group="calib.reports")} >= {"viz.writer:write"}
    assert {entry.value for entry in entry_points(group="calib.commands")} >= {"viz.command:view"}
    assert {entry.name for entry in entry_points(group="viz.decorations")} >= {"medrue"}

"""A result folder gets its two pages through the entry points, and `calib` gets its command."""

from functools import partial
from importlib.metadata import entry_points
from unittest import mock

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from calib.core.fitting.unexplained import unexplained_errors
from tests.viz.viz_examples import five_bar_fit, medrue_fit
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


@pytest.mark.parametrize(
    ("compute", "within"),
    [
        (pages, "viz.scene.scene_of_fit"),
        (partial(unexplained_errors, sized=False), "calib.core.fitting.unexplained.solve_beside_noise"),
    ],
)
def test_pages_and_what_they_ask_for_are_computed_with_one_blas_thread(compute, within):
    """On two busy cores, two threads took a second of the time of a page of 300 poses."""
    threads = set()

    def looking(*arguments, **options):
        own = (library for library in threadpool_info() if library["prefix"] == "libscipy_openblas")  # NumPy, SciPy
        threads.update(library["num_threads"] for library in own)
        raise KeyboardInterrupt

    with threadpool_limits(2, user_api="blas"), mock.patch(within, looking), pytest.raises(KeyboardInterrupt):
        compute(five_bar_fit())
    assert threads == {1}

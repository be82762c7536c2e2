"""Figures of check and select: drawn without a window, the same every time. Pages and figures through entry points."""

from importlib.metadata import entry_points

import numpy as np
import pytest

import calib
from calib.core.data.in_memory import as_poses
from calib.pictures import figures
from calib.planning.assessment import check
from calib.planning.selection import select
from medrue.workspace import target_workspace
from tests.viz.viz_examples import medrue_fit
from viz import pictures
from viz.selection_plots import accuracy, assessment_figures, index_history, selection_figures, singular_values

Q = target_workspace().q[::6]


@pytest.fixture(scope="module")
def assessment(medrue):
    return check(medrue, as_poses(medrue, Q))


@pytest.fixture(scope="module")
def selection(medrue):
    return select(medrue, Q, 20, starts=2)


def test_singular_values_show_the_threshold_and_the_gap(assessment):
    (axes,) = singular_values(assessment).axes
    heights = np.concatenate([line.get_ydata() for line in axes.lines[:2]])
    assert len(heights) == 36
    assert np.sum(heights > assessment.rank_all.threshold) == 28
    assert axes.patches  # the gap


def test_accuracy_is_drawn_against_the_number_of_poses(assessment):
    (axes,) = accuracy(assessment).axes
    uniform, chosen = axes.lines[:2]
    assert np.all(np.asarray(chosen.get_ydata()) <= np.asarray(uniform.get_ydata()) * (1 + 1e-9))
    assert max(chosen.get_xdata()) == len(Q)


def test_every_run_has_a_line_below_the_bound(selection):
    (axes,) = index_history(selection).axes
    curves = [line for line in axes.lines if len(line.get_xdata()) > 2]
    assert len(curves) == len([run for run in selection.runs if len(run.history) > 2])
    assert all(np.max(curve.get_ydata()) <= selection.bound for curve in curves)


@pytest.mark.quick(0)
def test_figures_are_svg_and_the_same_twice(assessment, selection):
    first = assessment_figures(assessment) | selection_figures(selection)
    again = assessment_figures(assessment) | selection_figures(selection)
    assert set(first) == {"singular_values.svg", "correlations.svg", "accuracy.svg", "index.svg"}
    assert first == again
    assert all(content.startswith(b"<?xml") for content in first.values())
    assert b"mathdefault" not in first["accuracy.svg"]


def test_a_fit_has_two_pages_and_the_entry_points_are_installed():
    result = pictures.pages(medrue_fit(validation=None))
    assert set(result) == {"report.html", "viewer.html"}
    assert all(page.startswith(b"<!DOCTYPE html>") for page in result.values())
    assert {(entry.name, entry.value) for entry in entry_points(group="calib.pictures")} >= {("view", "viz.pictures")}
    assert {entry.name for entry in entry_points(group="viz.decorations")} >= {"medrue"}
    with pytest.raises(TypeError, match="no figures of int"):
        pictures.figures(3)


def test_the_engine_finds_them_by_entry_point_and_says_where_nothing_draws(monkeypatch, selection):
    assert set(figures(selection)) == {"index.svg"}
    monkeypatch.setattr("calib.pictures.entry_points", lambda group: ())
    with pytest.raises(calib.InputError, match="nothing that draws is installed"):
        figures(selection)

"""A real Chromium, and pages to open in it. Tests skip where playwright or Chromium is missing."""

from pathlib import Path

import numpy as np
import pytest

from tests.browser.browser_tab import SIZE, Tab

CHROMIUM = Path("/usr/bin/chromium")

KEPT_TABS: dict[str, Tab] = {}
"""Tabs that tests share, by name."""


@pytest.fixture(scope="session")
def chromium_path():
    pytest.importorskip("playwright.sync_api", reason="playwright is not installed (extra 'browser')")
    if not CHROMIUM.exists():
        pytest.skip(f"{CHROMIUM} is missing (Debian package 'chromium')")
    return str(CHROMIUM)


@pytest.fixture(scope="session")
def chromium(chromium_path):
    from playwright.sync_api import sync_playwright

    with sync_playwright() as running:
        browser = running.chromium.launch(executable_path=chromium_path)
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def scene():
    """MedRUE calibrated, with one outlier among the validation poses."""
    from dataclasses import replace

    from tests.viz.viz_examples import medrue_fit
    from viz.scene import scene_of_fit

    shown = scene_of_fit(medrue_fit())
    outlier = np.zeros(len(shown.poses), dtype=bool)
    outlier[100] = True
    return replace(shown, poses=replace(shown.poses, outlier=outlier))


@pytest.fixture(scope="session")
def viewer_file(scene, tmp_path_factory):
    from viz.viewer_page import scene_page

    return scene_page(scene).save(tmp_path_factory.mktemp("pages") / "viewer.html")


def pytest_runtest_teardown(item, nextitem):
    """Empty the tabs where other tests follow: a page draws on, and takes a twentieth of a processor."""
    if nextitem is None or nextitem.path.parent != item.path.parent:
        for opened in KEPT_TABS.values():
            opened.empty()


@pytest.fixture
def kept(chromium):
    """The tab of a name, which tests share, as a new one takes a second; it must not complain."""
    used = []

    def tab(name, **options):
        used.append(KEPT_TABS.setdefault(name, None) or Tab(chromium, **options))
        KEPT_TABS[name] = used[-1]
        return used[-1]

    yield tab
    assert [problem for tab in used for problem in tab.problems] == []


@pytest.fixture
def show(kept):
    """Show any page: `show(address, ready, size)`."""

    def shown(address, ready="body[data-ready]", size=SIZE):
        tab = kept("others")
        tab.problems.clear()
        tab.requests.clear()
        tab.page.set_viewport_size({"width": size[0], "height": size[1]})
        return tab.open(address, ready)

    return shown


@pytest.fixture
def tab(kept, viewer_file):
    """The viewer as it is at first; the tests share one page, which takes seconds to load."""
    return kept("viewer").like_new(viewer_file.as_uri())

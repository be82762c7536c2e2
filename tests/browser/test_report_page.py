"""The report in a real Chromium: opens offline, asks nobody, text can be found and selected, prints."""

import pytest
from browser_tab import Tab


@pytest.fixture(scope="module")
def report_file(tmp_path_factory):
    from viz_examples import medrue_fit

    import viz

    return viz.report(medrue_fit(), command="calib fit").save(tmp_path_factory.mktemp("pages") / "report.html")


@pytest.mark.parametrize("size", [(1000, 900), (390, 844)])
def test_it_opens_without_errors_and_fits_the_window(chromium, report_file, size):
    tab = Tab(chromium, size=size)
    tab.open(report_file.as_uri(), "main")
    assert tab.problems == []
    assert len(tab.requests) == 1
    assert tab.page.evaluate("document.documentElement.scrollWidth") <= size[0]
    assert tab.page.locator("section").first.get_attribute("class").startswith("verdict")
    tab.context.close()


def test_text_of_plots_can_be_found_and_selected(chromium, report_file):
    tab = Tab(chromium)
    tab.open(report_file.as_uri(), "main")
    assert tab.page.evaluate("window.find('predicted minus measured')")
    assert "predicted minus measured" in tab.page.evaluate("getSelection().toString()")
    tab.context.close()


def test_it_prints(chromium, report_file):
    tab = Tab(chromium)
    tab.open(report_file.as_uri(), "main")
    document = tab.page.pdf(prefer_css_page_size=True)
    assert document.startswith(b"%PDF")
    tab.page.set_viewport_size({"width": 688, "height": 1000})  # what A4 leaves between the margins
    tab.page.emulate_media(media="print")
    assert tab.page.evaluate("Math.max(...[...document.querySelectorAll('table')].map((t) => t.scrollWidth))") <= 688
    assert (
        3 <= document.count(b"/Type /Page\n") + document.count(b"/Type/Page ") + document.count(b"/Type /Page ") <= 12
    )
    tab.context.close()

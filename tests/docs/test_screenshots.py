"""Pictures for the documentation: what is missing is said in one line. Taking them is tested in tests/browser."""

import pytest
from screenshots import chromium, take

from calib.core.base.errors import InputError


def test_a_folder_without_pages_is_an_error(tmp_path):
    pytest.importorskip("playwright.sync_api", reason="playwright is not installed (extra 'browser')")
    with pytest.raises(InputError, match=r"has no viewer\.html"):
        take(tmp_path)
    assert not (tmp_path / "out").exists()


def test_a_computer_without_chromium_is_told_what_to_install(monkeypatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(InputError, match="install the package 'chromium'"):
        chromium()

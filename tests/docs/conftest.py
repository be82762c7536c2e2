"""The tools of docs/site, importable."""

import sys

from tests.project import ROOT

sys.path.append(str(ROOT / "docs" / "site"))

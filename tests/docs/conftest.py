"""The tools of docs/site, importable."""

import sys
from pathlib import Path

SITE = Path(__file__).parents[2] / "docs" / "site"
sys.path.append(str(SITE))

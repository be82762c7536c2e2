"""Priors of known models: the files of the folder `models`.

`calib fleet` makes each from the maker's own calibrations of several robots of a type, as published by their owners
(files of `ur_calibration`): mean and spread of the joint origins, and the uncertainty of the mean. The stock URDF from
the maker's published Denavit-Hartenberg parameters is beside it. The first lines of a file state the number of robots.
"""

from __future__ import annotations

from pathlib import Path

MODELS = {path.stem: path for path in sorted((Path(__file__).parent / "models").glob("*.yaml"))}
"""The files, by the model's name."""

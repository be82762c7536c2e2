"""Priors of known models: the files of the folder `models`.

Each is what `calib fleet` makes of the maker's own calibrations of several robots of a type, as their owners published
them (files of `ur_calibration`): mean and spread of the joint origins, and what the robots leave open of the mean. The
stock URDF stands beside it, made of the maker's published Denavit-Hartenberg parameters. The first lines of a file
state how many robots are behind it.
"""

from __future__ import annotations

from pathlib import Path

MODELS = {path.stem: path for path in sorted((Path(__file__).parent / "models").glob("*.yaml"))}
"""The files, by the model's name."""

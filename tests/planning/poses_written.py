"""Poses of MedRUE as files, and the answers of commands about them."""

import json

import numpy as np

from calib.core.data.table_writing import format_table


def write_poses(path, q, names=None, more=()):
    """Write joint values (n, 6) in mm and deg, with names and further columns; return the path."""
    columns = [] if names is None else [("pose", names)]
    columns += [("q1 [mm]", list(1e3 * q[:, 0]))]
    columns += [(f"q{k} [deg]", list(np.degrees(q[:, k - 1]))) for k in range(2, 7)]
    path.write_text(format_table([*columns, *more]))
    return path


def answer(run):
    """Return the JSON that a command printed."""
    assert run.code == 0, run.err
    return json.loads(run.out)

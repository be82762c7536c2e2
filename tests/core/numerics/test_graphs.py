"""Parts of graphs and of patterns, against SciPy's."""

import numpy as np
import pytest
from scipy.sparse import csgraph, csr_matrix

from calib.core.numerics.graphs import connected_parts
from calib.core.robots.closure import blocks


def same_parts(ours, label):
    theirs = [np.flatnonzero(label == k).tolist() for k in range(label.max() + 1)]
    return sorted(part.tolist() for part in ours) == sorted(theirs)


@pytest.mark.parametrize("density", [0.02, 0.05, 0.1])
def test_parts_that_reach_each_other(density):
    rng = np.random.default_rng(1)
    for size in (1, 2, 7, 30, 60):
        links = rng.random((size, size)) < density
        strong = csgraph.connected_components(csr_matrix(links), connection="strong")[1]
        assert same_parts(connected_parts(links), strong)
        weak = csgraph.connected_components(csr_matrix(links), directed=False)[1]
        assert same_parts(connected_parts(links | links.T), weak)


def test_nodes_in_a_long_row_hang_together_and_no_nodes_are_no_parts():
    links = np.eye(100, k=1, dtype=bool)
    assert len(connected_parts(links | links.T)) == 1
    assert len(connected_parts(links)) == 100
    assert connected_parts(np.zeros((0, 0), dtype=bool)) == ()


def test_blocks_do_not_depend_on_the_order_of_rows_and_columns():
    rng = np.random.default_rng(2)
    sizes = (3, 1, 4, 2)
    ends = np.cumsum(sizes)
    pattern = np.triu(rng.random((10, 10)) < 0.3)
    for end, size in zip(ends, sizes, strict=True):
        part = slice(end - size, end)
        pattern[part, part] |= np.eye(size, dtype=bool) | np.roll(np.eye(size, dtype=bool), 1, axis=1)  # a ring
        pattern[end:, part] = False
    for _ in range(20):
        row, column = rng.permutation(10), rng.permutation(10)
        rows, columns = blocks(pattern[row][:, column])
        result = {
            (frozenset(row[r].tolist()), frozenset(column[c].tolist())) for r, c in zip(rows, columns, strict=True)
        }
        expected = {frozenset(range(end - size, end)) for end, size in zip(ends, sizes, strict=True)}
        assert result == {(part, part) for part in expected}

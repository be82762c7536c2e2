"""Chances and scales by which every room decides about findings."""

UNLIKELY = 1e-3
"""Chance below which the finding of a single test is no accident: a shared error, other noise than stated, a gain."""
FALSE_ALARM = 0.01
"""Chance of any false finding among many: outliers, patterns, changes, an unlike robot."""
HARDLY = 0.05
"""Chance, shared by all comparisons made together, below which a difference of results or regions counts."""
FEWEST = 5
"""Fewest poses for which Student's t is used."""
EXACT = 1e-9
"""Noise below this [SI] is rounding: the data were computed, not measured."""

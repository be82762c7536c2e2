"""Chances and scales by which all packages decide about findings."""

UNLIKELY = 1e-3
"""A finding of a single test is no accident if its chance is less: a shared error, other noise than stated, a gain."""
FALSE_ALARM = 0.01
"""Chance of any false finding among many: outliers, patterns, changes, an unlike robot."""
HARDLY = 0.05
"""A difference of results or regions counts if its chance, times the number of comparisons, is less."""
FEWEST = 5
"""Fewest poses for which Student's t is used."""
EXACT = 1e-9
"""Noise below this [SI] is rounding: the data were computed, not measured."""

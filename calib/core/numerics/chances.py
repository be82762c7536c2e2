"""Chances and scales by which every room decides about findings."""

UNLIKELY = 1e-3
"""Chance below which what one test finds is no accident: shared errors, noise other than stated, a gain, harm."""
FALSE_ALARM = 0.01
"""Chance that good data show any finding where many are looked for: outliers, patterns, changes, an unlike robot."""
HARDLY = 0.05
"""Chance, shared by all that are compared together, below which a difference counts: of results, or of regions."""
FEWEST = 5
"""Poses from which Student's t says anything."""
EXACT = 1e-9
"""Noise below this [SI] is rounding: the data were computed, not measured."""

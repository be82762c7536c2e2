"""The fit, its validation, its tests for bad data, and the verdict."""

"""Functions of arrays alone: rank and null space, observability, least squares, statistics, rigid fits."""

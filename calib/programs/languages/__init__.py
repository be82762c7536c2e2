"""Programs for the nominal robot, compensated: G-code, straight moves, grids of corrections."""

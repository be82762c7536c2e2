"""Kinematics compiled with numba: the formulas of the core, faster for many poses."""

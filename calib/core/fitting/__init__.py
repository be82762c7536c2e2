"""The parameter values that explain measurements best, and their uncertainty."""

"""The parameter values that explain measurements best, and how sure they are."""

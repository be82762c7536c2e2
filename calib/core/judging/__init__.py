"""The worth of a fit: patterns in its residuals, the verdict, and new readings against its predictions."""

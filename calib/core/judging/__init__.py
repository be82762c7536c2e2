"""What a fit is worth: what its residuals hide, the verdict, and new readings against what it predicts."""

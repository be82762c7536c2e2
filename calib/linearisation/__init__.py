"""The identification Jacobian, and what follows from it without a fit: information, prediction, registration."""

"""URDF as text: read, edited, and made from Denavit-Hartenberg parameters or from the lengths of a loop."""

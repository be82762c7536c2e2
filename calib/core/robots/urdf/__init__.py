"""URDF as text: read, edited, and made of Denavit-Hartenberg parameters or of the lengths of a loop."""

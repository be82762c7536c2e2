"""Several results: what differs between them, and the prior of the next robot of their model."""

"""The prior of the next robot of a model, from results of several robots."""

"""The robot and its uncertainty: from a reading to a judged fit, and its results."""

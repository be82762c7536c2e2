"""What the robot is, and how sure that is: from a reading to a judged fit, and its results."""

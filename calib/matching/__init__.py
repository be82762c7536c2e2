"""The twin of a controller: a robot that agrees with the poses that the controller prints."""

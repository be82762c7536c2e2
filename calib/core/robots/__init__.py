"""The robot: description, mechanism, kinematics, closed loops, parameters as edits of joint origins."""

"""The robot: URDF and description, mechanism, closed loops, parameters as edits of joint origins."""

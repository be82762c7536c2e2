"""Priors of models that ship with the program: one URDF and one YAML file a model."""

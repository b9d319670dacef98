"""Identify the dynamics of a manipulator from its recordings, and explain what the model leaves out."""

__version__ = "0.1.0"

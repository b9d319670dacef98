"""From prepared motions to parameters: solver, weights, uncertainty, physical consistency, validation."""

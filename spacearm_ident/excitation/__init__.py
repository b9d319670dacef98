"""Motions that make an arm tell its parameters: trajectories, their limits, their files."""

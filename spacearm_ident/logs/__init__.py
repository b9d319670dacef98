"""Logs of others: what their columns are, proposed from names, units and the arm, and read as recordings."""

"""From prepared motions to an identified model: fit, structure, cross-checks, validation, verdict."""

"""The arm's surroundings: gravity, temperature, and the free body that carries the arm."""

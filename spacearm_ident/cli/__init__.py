"""The offline command `spacearm`: options in, exit codes and one-line errors out; no formulas."""

"""Blind tests of `spacearm mismatch --simulation`: concealed differences between an arm and its simulation."""

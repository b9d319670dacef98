"""Simulated CiA 402 drives on a bus: object dictionary, PDOs, states, motion, faults."""

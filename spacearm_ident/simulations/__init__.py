"""Simulations of an arm as people have them (MJCF, URDF, SDF, model.yaml), read into one `Simulation`.

A simulation is an arm with values: bodies, and of every joint an armature, a damping, a friction loss, perhaps a
spring. Readers know a file format; nothing else does.
"""

from .read import SIMULATION_SUFFIXES, read_simulation
from .simulation import JointDynamics, Simulation, simulation_of

__all__ = ["SIMULATION_SUFFIXES", "JointDynamics", "Simulation", "read_simulation", "simulation_of"]

"""The simulated arm: a second, independent writing of the dynamics, with true standstill."""

"""Recordings as `Motion`s: stretches, periods, bandwidth, derivatives, and one filter for torque and columns."""

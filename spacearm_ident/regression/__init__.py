"""The least-squares problem of a torque model: rows by joint, the prior as further rows, held-out blocks of time."""

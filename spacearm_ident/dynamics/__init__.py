"""The arm and its torque: regressor, base parameters, friction; all contributions are terms of one model."""

"""A model as the prior of another: posterior, update from seconds of data, adaptation to another place."""

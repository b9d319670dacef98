"""Say what physics a model left out: noise floor, location, hypotheses that compete, and the story of it."""

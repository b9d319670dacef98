"""On line: the residual while samples come in, friction levels and payload followed, changes detected."""

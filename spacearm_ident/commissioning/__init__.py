"""From a URDF and a drive's data sheet to files the nodes can use, and checks of them and of the machine."""

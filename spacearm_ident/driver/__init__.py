"""Drive the arm: its CAN wiring, the safety policy, set-points onto the clock, the 1 kHz loop. Without ROS."""

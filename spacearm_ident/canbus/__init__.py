"""CAN and CANopen without ROS and without physics: buses, PDO layout, CiA 402, and the 1 kHz master."""

"""The identified model for simulators and controllers, with the cost of what each format cannot hold."""

"""What stands around the vehicle, what travels along, and where rays hit it."""

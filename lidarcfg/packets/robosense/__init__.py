"""RoboSense's packets."""

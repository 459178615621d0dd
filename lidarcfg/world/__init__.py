"""Scenes, motion, and a ray tracer: static and dynamic objects around a vehicle, and what rays hit of them."""

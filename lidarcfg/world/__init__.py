"""The world around a rig: scenes, what moves in them, the vehicle that carries the rig, and what rays hit.

To read in this order: `scene` has objects and their meshes, from `meshes`, `models`, `height_field` and `surfels`;
`motion` where things are at a time; `vehicle` the bodies that travel along; `tracer` what rays hit first. The hierarchy
and the rays are in `core/world`.
"""

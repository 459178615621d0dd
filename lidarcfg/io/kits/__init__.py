"""Kits: the sensors of a vehicle as other tools describe them, each in its frame, read as rigs.

To read in this order: `kit` is what all formats have in common, and makes the rig; `frames` is the tree of frames
that some of them hold. `autoware`, `nuscenes` and `kitti` read a format each; `io.urdf` and `io.carla` read theirs,
too, beside writing it. `readers` picks the format of a file or a folder, and reads a bag's /tf_static.
"""

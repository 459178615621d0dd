"""Kits: the sensors of a vehicle as other tools describe them, each in its frame, read as rigs.

To read in this order: `kit` is what all of them have in common, and makes the rig; `frames` the tree of frames that
some of them are. Each of the others is a format: `autoware`, `nuscenes`, `kitti`, besides `io.urdf` and `io.carla`,
which write theirs, too; `readers` tells which of them a file or a folder is, and reads a bag's /tf_static.
"""

"""Rigs from other tools: the sensors of a vehicle as these describe them, each in its frame.

To read in this order: `sensor_kit` is what all formats have in common, and makes the rig; `world.frame_tree` is the
tree of frames that some of them hold. `autoware`, `nuscenes`, `kitti` and `tf_static` (of bags) read a format each;
`io.urdf` and `io.carla` read theirs, too, beside writing it. `importer` picks the format of a file or a folder.
"""

"""From and to other tools: rigs, clouds, captures and drives in their formats.

To read in this order: `formats` lists them and converts; `export` is a simulation in one call; `drive_dataset` a drive
with its ground truth, as data sets have it. Each of the others is a format: of rigs `urdf`, `carla`, `launch`; of ROS
`bag`, with `messages`; of data sets `kitti` and `nuscenes`; of recordings `firings`, with `repack`.
`kits` reads rigs from others' formats, and `bag_reader` bags; `packet_bag` makes a capture of a driver's packets;
`self_filter` cuts a vehicle's own body away.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

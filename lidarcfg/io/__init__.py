"""From and to other tools: rigs, clouds, captures and drives in their formats.

To read in this order: `formats` lists the formats and converts; `export` is a simulation in one call; `drive_dataset`
is a drive with its ground truth, for data sets. Most others are a format each: `urdf`, `carla` and `launch` for rigs;
`bag` for ROS, with `ros_messages` and `ros_names`; `kitti` and `nuscenes` for data sets. `rig_importers` read rigs from
other tools' formats, `bag_reader` reads bags, `packet_bag` turns a driver's packets in a bag into a capture, and
`self_filter` writes filters that cut away the vehicle's own body. `sensor_tables` writes the rays of a
sensor, a `beam_table`, for other simulators, `omni_lidar` among them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

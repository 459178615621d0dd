"""The makers' packets, a folder each: `layout`, `model`, `encode`, `decode`, `telemetry`.

To read in this order: `codec` is the interface that each maker implements, `families` the registry of makers. Then a
maker: `velodyne`, `hesai`, `robosense`, `livox`, `ouster` or `seyond`. Several makers share `sensor_unit`, `headers`,
`blocks`, `loss`, `inertial`, `nmea` and `point_fields`. `emulator` is the interface for answering drivers; some makers
implement it in an `emulator` of their own.

A new maker is a folder here and a line in `families.FAMILIES`; docs/codec.md goes through it step by step.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Sensors, the rig that holds them, and when their lasers fire.

To read in this order: `sensor` has a model with its beams, `realism` what it gets wrong, `rig` the mounts of a vehicle,
`firing` when and where lasers fire, `schedule` the firing sequences of a sensor on its own clock. Of a sensor that does
not turn, `scan_pattern` has the firings and `pattern_timing` when they come.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

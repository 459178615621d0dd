"""Sensors, the rig that holds them, and when their lasers fire.

To read in this order: `sensor` is a model with its beams, `realism` its noise and dropouts, `faults` what goes wrong
with it for a while, `rig` the mounts on a vehicle, `firing` when and where lasers fire, `schedule` the firing sequences
of a sensor on its own clock. For a sensor that does not turn, `scan_pattern` has the firings, `mirror` those over a
mirror, and `pattern_timing` their times. `lidar_names` guesses models from the names of frames.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Sensors, and the rig that holds them.

To read in this order: `sensor` has a model with its beams, `firing` where its lasers fire in a revolution, `realism`
what it gets wrong, `rig` the mounts of a vehicle.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Sensors, and the rig that holds them.

To read in this order: `sensor` is a model with its beams, `firing` where its lasers fire in a revolution, `realism` its
noise and its losses, `rig` the mounts on a vehicle.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

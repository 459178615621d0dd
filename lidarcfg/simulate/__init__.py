"""What a rig's sensors report in a scene.

To read in this order: `tasks` says what is fired when, `simulator` what the rays of each firing hit, `echoes` what a
beam of some width makes of that, and how far off it is reported; `scans` gives the points.
`lidarcfg.capture.export` makes packets of the same echoes. `returns` counts the returns from an object at a place,
without any scene, and `beams` says what becomes of each beam there.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

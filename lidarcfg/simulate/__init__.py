"""What a rig's sensors report in a scene.

To read in this order: `drive` has the firings of a rig that moves, `aim` where their beams point; `caster` casts them
in a scene, batch by batch, as other simulators do in theirs. `scene_drive` adds a scene to a drive, `sensor_runs`
traces it chunk by chunk: `simulator` has the rays of each firing, `echoes` turns what they hit into echoes of a wide
beam, with noise; `faults` has what goes wrong with clock, rotation and window. `scans` gives the points.
`lidarcfg.capture.export` encodes the same echoes as packets. `lidarcfg.returns` counts what an object alone returns,
without any scene.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""VSR: the measure of the paper, Liu, Arief and Zhao (2018), and nothing else.

A rig's cost, `max_vsr(region, lidars)`, is these lines. A beam that spins is a cone about the axis of its LiDAR (II-A).

    labels = compare_labels(region, lidars)    # cuboids differ from neighbours where a cone passes between (III-B)
    subspaces = connect(labels)                # neighbours of equal labels: no beam enters them (III-C)
    vsr = volume_m3(subspaces) / surface_m2(subspaces)    # of each, counted in faces of cuboids (eq. 7 and 8)
    cost = vsr.max()                           # of the largest gap (eq. 10)

`segment` is the first two, and takes into account what LiDARs cannot see. `evaluate` runs them, too; a search computes
the same numbers trial by trial, in C++.

To read in this order: `region` cuts the space around the vehicle into cuboids; `cones` finds between which beams of a
LiDAR a point lies, `visibility` what the LiDAR cannot see; `subspaces` connects neighbouring cuboids of the same label;
`metric` computes the volume-to-surface ratio of each; `detection` says how often objects are detected.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

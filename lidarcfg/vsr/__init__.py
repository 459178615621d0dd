"""VSR: the measure of the paper, Liu, Arief and Zhao (2018), and nothing else.

The paper in a call, `max_vsr` in `metric`:

    subspaces = segment(region, lidars)  # cuboids -> labels by the cones of beams -> connected subspaces
    return vsr_m(subspaces).max()  # the largest volume-to-surface ratio

`evaluate` calls the same two functions; searches compute the same numbers trial by trial, in C++, and end with them.

To read in this order: `region` cuts the space around the vehicle into cuboids; `cones` finds between which beams of a
LiDAR a point lies, `visibility` what the LiDAR cannot see; `subspaces` connects neighbouring cuboids of the same label;
`metric` computes the volume-to-surface ratio of each subspace, `spheres` the largest ball inside; `detection` says how
often objects are detected. `zones` are parts of the region that weigh more; `extrapolation` finds what max VSR would be
for ever smaller cuboids.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

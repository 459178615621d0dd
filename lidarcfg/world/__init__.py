"""The world around a rig: scenes, what moves in them, the vehicle that carries the rig, and what rays hit.

To read in this order: `scene_file` has the keys of a scene; `scene` builds its objects, with triangles from `meshes`,
`gltf` and `gltf_models`, `height_field` and `surfels`, or as `mesh_source` gives them; `motion` says where they are
at any time, `pose_stream` where poses take them that come one after another; `vehicle` has the bodies that travel
along, `robot_body` that of a `robot` whose links are in a `frame_tree`; `mesh_frame` doubts their units, axes and
place, `simplify` makes do with fewer triangles, `solids` finds which points are inside them, `footprint` has outlines
from above; `tracer` finds what rays hit first, and what blocks them. For data sets there are `boxes` and `geodesy`;
`cuboids` draws parts of a grid. The bounding volume hierarchy and the ray casting are in `core/world`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

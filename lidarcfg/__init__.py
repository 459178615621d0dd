"""lidarcfg: where should the LiDARs sit on this vehicle, and what will they see?

The packages, from the ground up; each imports only those that stand before it in this list:

    config        our YAML files, strictly checked
    clouds        point clouds and their files
    sensors       sensor models, rigs, and when lasers fire
    world         scenes, vehicles, trajectories; what rays hit
    packets       the makers' packets, a folder each: encoded, decoded
    simulate      firings -> echoes -> returns
    returns       what sensors get from an object at places: misses
    vsr           the paper's measure: region -> cones -> labels -> subspaces -> VSR
    requirements  what a rig must see, and the verdict: PASS or FAIL
    solvers       they minimise over the unit cube
    study         which sensors may sit where, what is minimised, how well a rig does
    search        for the best rig, for the cheapest, for the sensors; sweeps
    capture       packets: exported, decoded, replayed, sent live
    io            from and to other tools
    report        JSON, tables, pictures, HTML pages
    viewer        the page in a browser, stills, Open3D's window
    cli           the commands

The ground are `core`, the hot loops in C++, and the modules beside this file: `errors`, `units`, `maths`, `geometry`,
`futures`, `files`, `inputs`, `notebook`.

`__init__.pyi` lists the public names. Each loads its module on first use, so `import lidarcfg` costs nothing.
"""

import lazy_loader

__version__ = "0.2.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

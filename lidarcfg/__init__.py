"""lidarcfg: where should the LiDARs sit on this vehicle, and what will they hear?

The public names are loaded on first use, so `import lidarcfg` costs nothing.
"""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_HOME = {
    "LidarcfgError": "errors",
    "Sensor": "sensor",
    "load_sensor": "sensor",
    "Rig": "rig",
    "load_rig": "rig",
    "save_rig": "rig",
    "Region": "placement.region",
    "Subspaces": "placement.subspace",
    "Study": "placement.study",
    "load_study": "placement.study",
    "optimize": "placement.optimize",
    "evaluate": "placement.study",
    "Scene": "world.scene",
    "load_scene": "world.scene",
    "PointCloud": "cloud",
}

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'lidarcfg' has no attribute {name!r}")
    return getattr(import_module(f"lidarcfg.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)

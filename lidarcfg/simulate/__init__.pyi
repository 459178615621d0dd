from .caster import Caster as Caster
from .drive import Drive as Drive
from .drive import RayBatch as RayBatch
from .scans import simulated_scans as simulated_scans
from .scene_drive import SceneDrive as SceneDrive
from .sensor_runs import SimulationOptions as SimulationOptions
from .simulator import Simulator as Simulator

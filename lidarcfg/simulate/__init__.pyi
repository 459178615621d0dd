from .drive import Drive as Drive
from .drive import RayBatch as RayBatch
from .scans import simulated_scans as simulated_scans
from .scene_drive import SceneDrive as SceneDrive
from .simulator import Simulator as Simulator
from .tasks import SimulationOptions as SimulationOptions

from .drive import Drive as Drive
from .scans import simulated_scans as simulated_scans
from .simulator import Simulator as Simulator
from .tasks import SimulationOptions as SimulationOptions

from .scans import simulated_scans as simulated_scans
from .simulator import Simulator as Simulator
from .tasks import Drive as Drive
from .tasks import SimulationOptions as SimulationOptions

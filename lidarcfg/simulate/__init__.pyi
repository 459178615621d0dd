from .drive import Drive as Drive
from .scans import simulated_scans as simulated_scans
from .sensor_runs import SimulationOptions as SimulationOptions
from .simulator import Simulator as Simulator

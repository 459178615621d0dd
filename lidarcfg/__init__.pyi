from .capture.decode import decode as decode
from .capture.live import Live as Live
from .capture.writer import Writer as Writer
from .clouds.cloud import PointCloud as PointCloud
from .errors import LidarcfgError as LidarcfgError
from .io.export import export as export
from .packets.families import pattern as pattern
from .search.optimize import optimize as optimize
from .sensors.rig import Rig as Rig
from .sensors.rig import load_rig as load_rig
from .sensors.rig import save_rig as save_rig
from .sensors.sensor import Sensor as Sensor
from .sensors.sensor import load_sensor as load_sensor
from .simulate.drive import Drive as Drive
from .study.evaluation import evaluate as evaluate
from .study.loading import load_study as load_study
from .study.study import Study as Study
from .vsr.region import Region as Region
from .vsr.subspaces import Subspaces as Subspaces
from .world.scene import Scene as Scene
from .world.scene import load_scene as load_scene

__version__: str

from .capture.decode import decode as decode
from .cloud import PointCloud as PointCloud
from .errors import LidarcfgError as LidarcfgError
from .formats.export import export as export
from .packets.families import pattern as pattern
from .placement.region import Region as Region
from .placement.study import Study as Study
from .placement.subspace import Subspaces as Subspaces
from .rig import Rig as Rig
from .rig import load_rig as load_rig
from .rig import save_rig as save_rig
from .sensor import Sensor as Sensor
from .sensor import load_sensor as load_sensor
from .studies import evaluate as evaluate
from .studies import load_study as load_study
from .studies import optimize as optimize
from .world.scene import Scene as Scene
from .world.scene import load_scene as load_scene

__version__: str

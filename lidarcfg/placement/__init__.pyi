from .cones import Lidar as Lidar
from .cones import rig_lidars as rig_lidars
from .evaluation import evaluate as evaluate
from .metric import max_vsr as max_vsr
from .optimize import place as place
from .region import Region as Region
from .study import Study as Study
from .study import load_study as load_study

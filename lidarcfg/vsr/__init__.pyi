from .cones import Lidar as Lidar
from .cones import rig_lidars as rig_lidars
from .metric import max_vsr as max_vsr
from .metric import vsr_m as vsr_m
from .region import Region as Region
from .subspaces import Subspaces as Subspaces
from .subspaces import segment as segment

from .boxes import boxed_objects as boxed_objects
from .motion import Motion as Motion
from .motion import Trajectory as Trajectory
from .scene import Scene as Scene
from .scene import load_scene as load_scene
from .tracer import Tracer as Tracer
from .vehicle import Vehicle as Vehicle
from .vehicle import load_vehicle as load_vehicle

from .optimize import optimize as optimize
from .optimize import place as place

from .evaluation import evaluate as evaluate
from .study import Study as Study
from .study import load_study as load_study

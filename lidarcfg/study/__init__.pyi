from .evaluation import evaluate as evaluate
from .loading import load_study as load_study
from .study import Study as Study

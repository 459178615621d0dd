from .comparison import save_comparison as save_comparison
from .front import save_front as save_front
from .results import evaluation_dict as evaluation_dict
from .results import save_evaluation as save_evaluation
from .results import save_placement as save_placement
from .rig_report import Baseline as Baseline
from .rig_report import Commands as Commands
from .sweep import SweepFolder as SweepFolder

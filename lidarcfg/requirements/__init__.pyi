from .file import load_requirements as load_requirements
from .resolved import Requirements as Requirements
from .robustness import Robust as Robust
from .verdict import RequirementVerdict as RequirementVerdict
from .verdict import Verdict as Verdict
from .verify import Verifier as Verifier

from .document import yaml_text as yaml_text
from .kinds import kind_of as kind_of
from .models import Model as Model
from .models import Section as Section
from .models import error_at as error_at
from .models import load as load

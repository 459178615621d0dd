from types import ModuleType

from lidarcfg.core import maths as maths
from lidarcfg.core import packets as packets
from lidarcfg.core import returns as returns
from lidarcfg.core import simulate as simulate
from lidarcfg.core import viewer as viewer
from lidarcfg.core import vsr as vsr
from lidarcfg.core import world as world

compiled: ModuleType

from .codec import Codec as Codec
from .codec import DecodedReturns as DecodedReturns
from .codec import Decoder as Decoder
from .codec import Payloads as Payloads
from .families import FAMILIES as FAMILIES
from .families import family as family
from .families import pattern as pattern
from .families import timing as timing

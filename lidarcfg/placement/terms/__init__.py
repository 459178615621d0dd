"""The terms of an objective: a term is a module, and a line here.

To read in this order: `term` is the protocol, then a term each.
"""

from lidarcfg.placement.terms.detection import DetectionTerm
from lidarcfg.placement.terms.inscribed_radius import InscribedRadius
from lidarcfg.placement.terms.max_vsr import MaxVsr
from lidarcfg.placement.terms.misses import MissesTerm
from lidarcfg.placement.terms.term import Term
from lidarcfg.placement.terms.unseen import BlindVolume, SeenByTwo

TERMS: dict[str, type[Term]] = {  # by their keys in files; their weighted values are added in this order
    DetectionTerm.key: DetectionTerm,
    MissesTerm.key: MissesTerm,
    MaxVsr.key: MaxVsr,
    InscribedRadius.key: InscribedRadius,
    BlindVolume.key: BlindVolume,
    SeenByTwo.key: SeenByTwo,
}

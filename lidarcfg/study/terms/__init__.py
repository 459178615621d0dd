"""The terms of an objective: a term is a module, and a line here.

To read in this order: `term` is the protocol, then a term each.
"""

from lidarcfg.study.terms.detection import DetectionTerm
from lidarcfg.study.terms.inscribed_radius import InscribedRadius
from lidarcfg.study.terms.max_vsr import MaxVsr
from lidarcfg.study.terms.misses import MissesTerm
from lidarcfg.study.terms.term import Term
from lidarcfg.study.terms.unseen import BlindVolume, SeenByTwo

TERMS: dict[str, type[Term]] = {  # by their keys in files; their weighted values are added in this order
    DetectionTerm.key: DetectionTerm,
    MissesTerm.key: MissesTerm,
    MaxVsr.key: MaxVsr,
    InscribedRadius.key: InscribedRadius,
    BlindVolume.key: BlindVolume,
    SeenByTwo.key: SeenByTwo,
}

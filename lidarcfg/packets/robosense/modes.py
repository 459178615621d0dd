"""The return mode of each MSOP packet: by the DIFOP packets, once a second, and by the layout between them."""

import numpy as np

from lidarcfg.packets.codec import Flags, Octets, Source, Times
from lidarcfg.packets.robosense.difop import every
from lidarcfg.packets.robosense.facts import Unit
from lidarcfg.packets.robosense.layout import MODES, REVOLUTION, Packets, packets_of, read_time_ns
from lidarcfg.units import SECOND_NS

NAMES = {code: name for name, code in MODES.items()}
DUAL = MODES["dual"]


def return_modes(unit: Unit, source: Source, octets: Octets) -> Times | None:
    """(P,) the codes of the modes of successive packets (P, 1248); None where no DIFOP packet says any.

    A mode holds from the DIFOP packet that says it. Where there are dual and single returns, each packet's own layout
    says which they are, as a mode changes before a DIFOP says so.
    """
    packets, difops = packets_of(octets), every(source)
    difops = difops[np.isin(difops["return_mode"], list(NAMES))]
    if not len(difops):
        return None
    at, said_ns, codes = read_time_ns(packets), read_time_ns(difops), difops["return_mode"].astype(np.int64)
    if not ((codes == DUAL).any() and (codes != DUAL).any()):
        return _latest(at, said_ns, codes)
    single = codes != DUAL
    return np.where(_dual(unit, packets), DUAL, _latest(at, said_ns[single], codes[single]))


def _latest(at: Times, said_ns: Times, codes: Times) -> Times:
    """(P,) the latest value at these times (P,); before the first value, that one."""
    order = np.argsort(said_ns, kind="stable")
    last = np.searchsorted(said_ns[order], at, side="right") - 1
    return codes[order][np.maximum(last, 0)]


def _dual(unit: Unit, packets: Packets) -> Flags:
    """(P,) whether each holds dual returns: blocks of one azimuth in pairs, or of 16 lasers that fired once."""
    azimuth = packets["blocks"]["azimuth"].astype(np.int64)
    if unit.count == 32:
        return np.asarray((azimuth[:, ::2] == azimuth[:, 1::2]).mean(axis=1) > 0.5)
    block = np.median(np.diff(azimuth, axis=1) % REVOLUTION, axis=1)
    turned, gap_ns = np.diff(azimuth[:, 0]) % REVOLUTION, np.diff(read_time_ns(packets))
    known = gap_ns > 0
    per_ns = np.median(turned[known] / gap_ns[known]) if known.any() else REVOLUTION * 10 / SECOND_NS
    return np.asarray(block < 1.5 * per_ns * unit.spin(dual=True).sequence_ns)

"""What the tests of Hesai's AT series share."""

import numpy as np

from lidarcfg.capture.ethernet import ethernet_frames
from lidarcfg.capture.export import save_sidecar_files
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.packets.families import codec
from lidarcfg.units import START_NS
from tests.packets.hesai.recorded import mount

FACETS = "at128e2x", "at128e3x"  # with a mirror of three facets
MODELS = FACETS
CODES = {"first": 0x33, "strongest": 0x37, "last": 0x38, "dual": 0x39, "first-last": 0x3B, "first-strongest": 0x3C}


def sensed(of, slots):
    """A batch with ranges and reflectivities out of a hat: a tenth measures nothing, half of the pairs are one."""
    rng = np.random.default_rng(3)
    maker = codec(of.sensor)
    (batch,) = maker.schedule(of, START_NS, [slots])
    shape = len(batch.firings.time_ns), 1 + of.dual
    range_m = np.sort(rng.uniform(1.5, 60.0, shape), axis=1)
    range_m[:, 0] -= 0.02 * of.dual
    range_m[::10] = np.inf
    reflectivity = rng.integers(0, 256, shape, np.uint8)
    alone = rng.random(len(range_m)) < 0.5
    range_m[alone] = range_m[alone][:, -1:]
    reflectivity[alone] = reflectivity[alone][:, :1]
    return batch, range_m, reflectivity, maker.encode(of, batch, range_m, reflectivity)


def written(of, path, slots):
    """A capture of that, with its files."""
    batch, range_m, reflectivity, payloads = sensed(of, slots)
    write_pcap(path, [ethernet_frames(of.host, payloads)])
    save_sidecar_files(path, [of])
    return batch, range_m, reflectivity, payloads


__all__ = ["CODES", "FACETS", "MODELS", "mount", "sensed", "written"]

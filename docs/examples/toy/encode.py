"""From firings to packets."""

import numpy as np

from .layout import MAGIC, RETURN, packet, packets_of


def encode(firings, batch, range_m, reflectivity):
    """The packets of a batch, each with so many firings."""
    packets = np.zeros(len(batch.number), packet(firings))
    packets["magic"] = MAGIC
    packets["number"] = batch.number
    millimetres = np.rint(np.where(range_m < 1e6, range_m, 0) * 1000)
    columns = batch.firings.time_ns, batch.firings.encoder_rad, millimetres, batch.firings.laser, reflectivity
    for key, column in zip(RETURN.names, columns, strict=True):
        packets["returns"][key] = column.reshape(len(packets), -1)
    return packets


def sent(data):
    """(firings, 1) which of them are returns in the packets."""
    return packets_of(data)["returns"]["range_mm"].reshape(-1, 1) > 0

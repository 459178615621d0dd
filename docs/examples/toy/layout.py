"""The bytes of a toy's packets."""

import numpy as np

from lidarcfg.packets.headers import Header, Network

MAGIC = b"TOY1"  # of data packets
RETURN = np.dtype([("time_ns", "<i8"), ("azimuth", "<f8"), ("range_mm", "<u4"), ("laser", "u1"), ("strength", "u1")])
POSITION = np.dtype([("magic", "S4"), ("time_ns", "<i8"), ("xyz_m", "<f8", 3)])
NETWORK = Network(source="", mac_prefix="02:00:00", destination_mac="ff:ff:ff:ff:ff:ff", destination_ip="10.0.0.1")
HEADER = Header(ttl=64, dont_fragment=False, numbered=True, checksum=True)


def packet(firings):
    """A data packet with this many firings."""
    return np.dtype([("magic", "S4"), ("number", "<u4"), ("returns", RETURN, firings)])


def octets(packets):
    """Packets (n,) as octets (n, size)."""
    return packets.view(np.uint8).reshape(len(packets), -1)


def packets_of(data):
    """Octets (n, size) as data packets (n,)."""
    return data.view(packet((data.shape[1] - 8) // RETURN.itemsize)).reshape(-1)

"""What a toy reports about itself: once a second, where in the world it is."""

import numpy as np

from lidarcfg.packets.codec import Payloads

from .layout import HEADER, NETWORK, POSITION, octets

SECOND_NS = 1_000_000_000


def positions(mount, trajectory, start_ns, due_ns):
    """The position packets."""
    first, end = (-(-at_ns // SECOND_NS) for at_ns in (due_ns.start, due_ns.stop))
    time_ns = start_ns + np.arange(first, end) * SECOND_NS
    packets = np.zeros(len(time_ns), POSITION)
    packets["magic"] = b"TOYP"
    packets["time_ns"] = time_ns
    packets["xyz_m"] = trajectory.world(np.tile(mount.position_m, (len(time_ns), 1)), time_ns)
    yield Payloads(time_ns, octets(packets), mount.telemetry_port, NETWORK, HEADER, first)

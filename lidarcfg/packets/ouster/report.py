"""What an Ouster says of its condition: the window in each pixel, the thermal shutdown in the packet's header.

The header's countdown is of the seconds that are left; the profiles with a window have a byte of it in each pixel. How
dirt makes this byte is not public: it is taken as the fraction of returns lost, of 255. After a restart the id of the
initialization is another one, so that it is not that of the metadata (Ouster's sensor documentation, packet header).
"""

from dataclasses import replace

import numpy as np

from lidarcfg.geometry import Bytes
from lidarcfg.packets.condition import Condition
from lidarcfg.packets.ouster.layout import (
    Layout,
    column_headers,
    column_values,
    crc64,
    packet_headers,
    values,
    write_packet_headers,
)
from lidarcfg.packets.ouster.model import Mode

COUNTDOWN_AT = 16  # bytes of the header
SHUTDOWN_AT = 18
IMMINENT = 1
COUNTDOWN_S = 30  # from the alarm to the shutdown
INITS = 1 << 24
FULL = 255  # a window that nothing passes


def report(mode: Mode, data: Bytes, condition: Condition) -> Bytes:
    """Lidar packets (P, size) with what the sensor says."""
    packets = data.copy()
    layout = mode.layout
    checksum_at = layout.size - 8
    checked = not layout.legacy and bool((values(data, "<u8", checksum_at) == crc64(data)).all())
    if not layout.legacy:
        init = (mode.init + condition.restarts) % INITS
        write_packet_headers(layout, packets, replace(packet_headers(layout, packets), init=init))
        left_s = np.where(condition.hot, np.ceil(COUNTDOWN_S - np.nan_to_num(condition.hot_s)), 0)
        values(packets, "u1", COUNTDOWN_AT)[:] = np.clip(left_s, 0, COUNTDOWN_S)
        values(packets, "u1", SHUTDOWN_AT)[:] = IMMINENT * condition.hot
    if mode.modern and "window" in layout.profile.fields:
        _write_window(layout, packets, condition)
    if checked:
        values(packets, "<u8", checksum_at)[:] = crc64(packets)
    return packets


def _write_window(layout: Layout, packets: Bytes, condition: Condition) -> None:
    """Write the window of all pixels of a column that points through dirt."""
    measurement = column_headers(layout, packets).measurement
    azimuth_deg = (measurement / layout.columns_per_frame + 0.5) % 1 * 360
    blocked = np.zeros(measurement.shape)
    for dirt in condition.dirt:
        covered = dirt.there[:, None] & dirt.covers(azimuth_deg)
        blocked = np.where(covered, np.maximum(blocked, dirt.fraction), blocked)
    field = layout.profile.fields["window"]
    assert (field.bit % 8, field.bits) == (0, 8)
    for pixel in range(layout.pixels):
        at = layout.column_head + pixel * layout.pixel + field.bit // 8
        column_values(layout, packets, "u1", at)[:] = np.rint(FULL * blocked)

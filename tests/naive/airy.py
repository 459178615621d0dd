"""RoboSense Airy in plain loops, from its manual (version 1.3: tables 9 to 13, 25, 26, 32) and rs_driver's geometry.

Channels count from 0. Bytes that only rs_driver names: 16 and 17 of MSOP (0 and 3: dual returns), 289 of DIFOP (how
the unit stands: 0 upright, 1 on its side, 2 Airy M) and the two upper bits of a distance (a point's feature).
"""

import math
import struct

TURN = 36000  # hundredths of a degree
COLUMN_US = 444.44 / 4  # table 8: a packet holds four columns; rs_driver has 111.08
LENS_M = math.hypot(0.0075, 0.00664)  # rs_driver: RX, RY
LENS_UP_M = 0.04532  # rs_driver: RZ
# Groups of eight channels fire at once. Upright: table 32; the others: rs_driver.
UPRIGHT_US = (0, 5.712, 12.376, 19.04, 25.704, 33.32, 41.888, 50.456, 59.024, 70.448, 81.872, 93.296)
SIDEWAYS_US = (0, 11.424, 22.848, 34.272, 45.696, 54.264, 62.832, 71.4, 79.016, 85.68, 92.344, 99.008)
AIRY_M_US = (0, 7.616, 16.184, 24.752, 33.32, 42.84, 52.36, 61.88, 71.4, 79.968, 88.536, 97.104)
FIRING_US = {0: UPRIGHT_US, 1: SIDEWAYS_US, 2: AIRY_M_US}


def utc_us(payload: bytes, at: int) -> int:
    """Six bytes of seconds, four of microseconds."""
    return int.from_bytes(payload[at : at + 6], "big") * 10**6 + int.from_bytes(payload[at + 6 : at + 10], "big")


def difop(payload: bytes) -> dict[str, object]:
    """Speed, addresses, ports, return mode, stamp and the angles of 96 channels in degrees."""
    assert len(payload) == 1248
    assert payload[:8].hex() == "a5ff005a11115555"
    assert payload[1246:].hex() == "0ff0"
    angles_deg = {}
    for name, first in (("vertical_deg", 468), ("horizontal_deg", 756)):
        found = []
        for channel in range(96):
            sign, hundredths = struct.unpack_from(">BH", payload, first + 3 * channel)
            assert sign in (0, 1)
            found.append((-hundredths if sign else hundredths) / 100)
        angles_deg[name] = found
    return {
        "rpm": struct.unpack_from(">H", payload, 8)[0],
        "source": ".".join(str(byte) for byte in payload[10:14]),
        "destination": ".".join(str(byte) for byte in payload[14:18]),
        "mac": payload[18:24].hex(":"),
        "msop_port": struct.unpack_from(">H", payload, 24)[0],
        "difop_port": struct.unpack_from(">H", payload, 28)[0],
        "install_mode": payload[289],
        "serial": payload[292:298].hex(),
        "return_mode": {0: "strongest", 1: "first", 2: "last", 3: "dual"}[payload[300]],
        "time_us": utc_us(payload, 303),
        "rpm_now": struct.unpack_from(">H", payload, 373)[0],
        **angles_deg,
    }


def columns(payload: bytes) -> list[tuple[int, int, list[bytes]]]:
    """(azimuth in hundredths, number in the packet, channel data of 96 channels) of each column and return.

    Single returns: two blocks a column, channels 1 to 48 and 49 to 96. Dual: four, a pair for each return.
    """
    assert len(payload) == 1248
    assert payload[:4].hex() == "55aa055a"
    assert payload[16] == 0
    assert (payload[31], payload[32]) == (0x31, 2)
    dual = payload[17] == 3
    found = []
    for pair in range(4):
        channels = []
        azimuths = []
        for block in (2 * pair, 2 * pair + 1):
            at = 42 + 148 * block
            assert payload[at : at + 2] == b"\xff\xee"
            azimuths.append(struct.unpack_from(">H", payload, at + 2)[0])
            channels += [payload[at + 4 + 3 * c : at + 7 + 3 * c] for c in range(48)]
        assert azimuths[0] == azimuths[1]
        found.append((azimuths[0], pair // 2 if dual else pair, channels))
    return found


def msop(
    payload: bytes,
    horizontal_deg: list[float],
    install_mode: int = 0,
    rpm: float = 600,
    next_azimuth: int | None = None,
) -> list[tuple[int, float, float, int, float]]:
    """(channel, azimuth in degrees, distance in metres, intensity, time after the packet's stamp in us) of each return.

    A block's azimuth is that of its first channel; the head turns on until a channel fires. `next_azimuth` is the
    first of the packet after, in hundredths; without it, and across a gap of more than a degree, the speed tells.
    """
    found = []
    seen = columns(payload)
    for azimuth, number, channels in seen:
        after = next((later for later, n, _ in seen if n > number), next_azimuth)
        nominal = TURN * rpm / 60 * COLUMN_US * 1e-6
        step = nominal if after is None or (after - azimuth) % TURN > 100 else (after - azimuth) % TURN
        for channel, data in enumerate(channels):
            raw, intensity = struct.unpack(">HB", data)
            distance_m = (raw & 0x3FFF) * 0.005
            if distance_m == 0:
                continue
            late_us = FIRING_US[install_mode][channel // 8]
            head_deg = (azimuth + step * late_us / COLUMN_US) / 100
            azimuth_deg = (head_deg + horizontal_deg[channel]) % 360
            found.append((channel, azimuth_deg, distance_m, intensity, number * COLUMN_US + late_us))
    return found


def point(
    azimuth_deg: float, distance_m: float, vertical_deg: float, horizontal_deg: float
) -> tuple[float, float, float]:
    """As rs_driver has it: x forward, azimuth clockwise, the lens off the axis towards where the head points."""
    azimuth = math.radians(azimuth_deg)
    head = math.radians(azimuth_deg - horizontal_deg)
    flat_m = distance_m * math.cos(math.radians(vertical_deg))
    return (
        flat_m * math.cos(azimuth) + LENS_M * math.cos(head),
        -flat_m * math.sin(azimuth) - LENS_M * math.sin(head),
        distance_m * math.sin(math.radians(vertical_deg)) + LENS_UP_M,
    )


def imu(payload: bytes) -> dict[str, object]:
    """Stamp, acceleration in g, angular velocity in rad/s and count of an IMU packet (table 13).

    Table 13 states no byte order: rs_driver reads the six values most significant byte first.
    """
    assert len(payload) == 51
    assert payload[:4].hex() == "aa555a05"
    assert payload[49:].hex() == "f00f"
    raw = struct.unpack_from(">6i", payload, 14)
    full_g = 2 << payload[43]
    full_rad_s = math.radians(250 << payload[44])
    return {
        "time_us": utc_us(payload, 4),
        "acceleration_g": [value * full_g / 32768 for value in raw[:3]],
        "angular_velocity_rad_s": [value * full_rad_s / 32768 for value in raw[3:]],
        "rate_hz": {0: 25, 1: 50, 2: 100, 3: 200, 4: 1000}[payload[42]],
        "count": payload[45:49],
    }

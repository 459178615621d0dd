"""What packets say of their firings, one by one, and packets of that again."""

import numpy as np

from lidarcfg.core import packets as core
from lidarcfg.packets.codec import Batch, Firings, Measurements, Times
from lidarcfg.packets.velodyne.encode import encode, returned
from lidarcfg.packets.velodyne.facts import Calibration, Unit
from lidarcfg.packets.velodyne.layout import RADIANS, REVOLUTION, Packets, device_time_ns, gaps_ns, is_dual, slots

MODES = "strongest", "last", "dual"


def measurements(unit: Unit, packets: Packets, host_ns: Times) -> Measurements:
    """All firings of packets (P,) of one return mode: see `Codec.measurements`.

    Ranges are what distances and the lasers' offsets far off make; an HDL-64E's other corrections are left to decoding.
    """
    mode = MODES[int(return_modes(unit, packets[:1])[0])]
    dual = mode == "dual"
    spin = unit.spin(dual)
    azimuth = np.ascontiguousarray(
        packets["blocks"]["azimuth"][:, : unit.span(dual) * (spin.sequences // spin.per_azimuth) : unit.span(dual)],
        np.uint16,
    )
    group_ns = spin.per_azimuth * spin.sequence_ns
    gap_ns = np.append(gaps_ns(packets["stamp_us"]), 0)
    step, late_ns = core.velodyne_turning(azimuth, gap_ns, spin.period_ns, group_ns)
    group = np.arange(spin.sequences) // spin.per_azimuth
    fraction = (spin.offsets_ns - unit.head_offset_ns) / group_ns - group[:, None]
    head = (azimuth[:, group, None] + step[:, group, None] * fraction) * RADIANS
    stamp_ns = device_time_ns(packets["stamp_us"], host_ns)
    time_ns = stamp_ns[:, None, None] + spin.offsets_ns + late_ns[:, group, None]
    laser = np.broadcast_to(np.arange(unit.count, dtype=np.uint8), time_ns.shape).ravel()
    distance, intensity = returned(unit, mode, packets)
    range_m = distance * unit.resolution_m + unit.distance_offset_m[laser][:, None]
    range_m[distance == 0] = np.inf
    batch = Batch(Firings(time_ns.ravel(), laser, head.ravel()), np.arange(len(packets)), host_ns)
    return Measurements(mode, batch, range_m, intensity)


def packed(unit: Unit, found: Measurements) -> Packets:
    """Packets (P,) of measurements, as `measurements` has them of recordings."""
    facts = unit.facts.model_copy(
        update={"calibration": Calibration(distance_offset_mm=unit.facts.calibration.distance_offset_mm)}
    )
    plain, dual = Unit(unit.sensor, facts), found.return_mode == "dual"
    packets = encode(plain, found.return_mode, found.batch.firings, found.range_m, found.reflectivity)
    number, span = slots(unit.packet, dual), unit.span(dual)
    blocks = packets["blocks"][:, : len(number)]
    blocks["returns"]["intensity"] = found.reflectivity.reshape(len(packets), -1)[:, number]
    azimuth = np.repeat(np.rint(unit.spin(dual).head_rad(found.batch.firings) / RADIANS), span, axis=1)
    blocks["azimuth"][azimuth == REVOLUTION] = REVOLUTION
    return packets


def return_modes(unit: Unit, packets: Packets) -> Times:
    """(P,) of MODES. Packets that say a mode which the sensor does not have are taken for the strongest returns."""
    codes = unit.packet.return_modes
    last = packets["return_mode"] == codes.last if codes else np.zeros(len(packets), np.bool_)
    return np.where(is_dual(unit.packet, packets), MODES.index("dual"), last.astype(np.int64))

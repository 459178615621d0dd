"""Packets with bytes changed at random: a cloud or one line, never a crash, never points that are not finite."""

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.pcap import Datagram
from lidarcfg.errors import PacketError
from lidarcfg.packets.seyond.layout import crcs
from lidarcfg.units import START_NS
from tests.capture_fixtures import no_warning, write_datagrams
from tests.packets.seyond.fixtures import MODELS, encoded, mount, table


def written(path, payloads, model: str) -> None:
    """A capture of packets, those of a Robin W behind its table."""
    rows = [table(model)] if model == "robin-w" else []
    rows += [row.tobytes() for row in payloads]
    write_datagrams(
        path, [Datagram(START_NS + n * 100_000, "172.168.1.10", 8010, 8010, row) for n, row in enumerate(rows)]
    )


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_changed_bytes(model, tmp_path):
    rng = np.random.default_rng(5)
    path = tmp_path / "drive.pcap"
    payloads = encoded(mount(model, "dual"), range(24))[3]
    good = 0
    errors = set()
    for number in range(12):
        data = payloads.data.copy()
        for _ in range(rng.integers(1, 4)):
            column = rng.integers(70) if rng.random() < 0.7 else rng.integers(data.shape[1])
            rows = slice(None) if rng.random() < 0.5 else rng.integers(24)
            data[rows, column] = rng.integers(256)
        if number % 4:  # an attacker knows the CRC, too
            data[:, 6:10] = crcs(data)[:, None].view(np.uint8)
        written(path, data, model)
        try:
            for cloud in decode_pcap(path, lambda warning: None):
                assert np.isfinite(cloud.xyz).all()
                assert (cloud.time_ns >= 0).all()
                good += len(cloud.xyz)
        except PacketError as error:
            errors.add(str(error))
    assert good > 24 * 96
    assert errors
    assert all("\n" not in one and str(path) in one for one in errors)


@pytest.mark.parametrize("start_us", [np.nan, np.inf, -np.inf, -1.0, 1e300, 5e-324])
def test_stamps_that_are_no_times(start_us, tmp_path):
    payloads = encoded(mount(), range(20))[3]
    payloads.data[:, 16:24] = np.frombuffer(np.float64(start_us).tobytes(), np.uint8)
    payloads.data[:, 6:10] = crcs(payloads.data)[:, None].view(np.uint8)
    path = tmp_path / "late.pcap"
    written(path, payloads.data, "falcon-k1")
    (cloud,) = decode_pcap(path, no_warning)
    assert (cloud.time_ns >= 0).all()


def test_a_robin_w_without_its_table(tmp_path):
    """The nominal angles are taken, and a warning says so; a damaged table is none, one beside the capture is."""
    payloads = encoded(mount("robin-w"), range(20))[3]
    path = tmp_path / "bare.pcap"
    warnings = []
    written(path, payloads.data, "falcon-k1")
    (bare,) = decode_pcap(path, warnings.append)
    assert ["table of angles" in one for one in warnings] == [True]
    damaged = bytearray(table("robin-w"))
    damaged[5000] ^= 1
    datagrams = [Datagram(START_NS, "172.168.1.10", 8010, 8010, bytes(damaged))]
    datagrams += [
        Datagram(START_NS + n, "172.168.1.10", 8010, 8010, row.tobytes()) for n, row in enumerate(payloads.data)
    ]
    write_datagrams(path, datagrams)
    (again,) = decode_pcap(path, warnings.append)
    np.testing.assert_array_equal(again.xyz, bare.xyz)
    assert len(warnings) == 2
    path.with_suffix(".anglehv").write_bytes(table("robin-w"))
    (beside,) = decode_pcap(path, no_warning)
    np.testing.assert_array_equal(beside.xyz, bare.xyz)

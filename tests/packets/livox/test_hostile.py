"""Packets with bytes changed at random: a cloud or one line, never a crash, never points that are not finite."""

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.pcap import Datagram
from lidarcfg.errors import PacketError
from lidarcfg.units import START_NS
from tests.capture_fixtures import write_datagrams
from tests.packets.livox.fixtures import encoded, mount


@pytest.mark.slow
@pytest.mark.parametrize("data_type", ["cartesian_mm", "spherical"])
def test_changed_bytes(data_type, tmp_path):
    rng = np.random.default_rng(5)
    path = tmp_path / "drive.pcap"
    batch, _, _, payloads = encoded(mount("mid-360", data_type), 24)
    good = 0
    errors = set()
    for _ in range(8):
        data = payloads.data.copy()
        for _ in range(rng.integers(1, 4)):
            column = rng.integers(36) if rng.random() < 0.7 else rng.integers(data.shape[1])
            rows = slice(None) if rng.random() < 0.5 else rng.integers(24)
            data[rows, column] = rng.integers(256)
        write_datagrams(
            path,
            [
                Datagram(int(sent_ns), "192.168.1.121", 56300, 56301, row.tobytes())
                for sent_ns, row in zip(batch.sent_ns, data, strict=True)
            ],
        )
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


def test_a_stamp_at_the_end_of_time(tmp_path):
    _, _, _, payloads = encoded(mount(), 20)
    payloads.data[:, 28:36] = 255
    path = tmp_path / "late.pcap"
    rows = enumerate(payloads.data)
    datagrams = [Datagram(START_NS + n * 480_000, "192.168.1.121", 56300, 56301, row.tobytes()) for n, row in rows]
    write_datagrams(path, datagrams)
    (cloud,) = decode_pcap(path, lambda warning: None)
    assert (cloud.time_ns > 9 * 10**18).all()

"""Packets with bytes changed at random: a cloud or one line, never a crash, never points that are not finite."""

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.pcap import Datagram
from lidarcfg.errors import PacketError
from lidarcfg.packets.families import codec
from lidarcfg.units import START_NS
from tests.capture_fixtures import write_datagrams
from tests.packets.robosense.fixtures import mount

MOST_M = 65535 * 0.0025 + 0.05


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["strongest", "dual"])
@pytest.mark.parametrize("model", ["helios-16p", "helios-32", "airy", "fairy"])
def test_changed_bytes(model, mode, tmp_path):
    rng = np.random.default_rng(7)
    of = mount(model, return_mode=mode)
    path = tmp_path / "drive.pcap"
    maker = codec(of.sensor)
    batch = next(maker.schedule(of, START_NS, [range(40)]))
    shape = len(batch.firings.time_ns), 1 + (mode == "dual")
    msop = maker.encode(of, batch, rng.uniform(1, 40, shape), rng.integers(0, 256, shape, np.uint8)).data
    difop = next(maker.housekeeping(of, None, None, START_NS, range(1)))
    good = 0
    errors = []
    for _ in range(20):
        sent = msop.copy()
        said = difop.data[0].copy()
        for _ in range(rng.integers(1, 4)):
            column = rng.integers(46) if rng.random() < 0.6 else rng.integers(1248)
            rows = slice(None) if rng.random() < 0.5 else rng.integers(40)
            sent[rows, column] = rng.integers(256)
        for _ in range(rng.integers(20)):
            at = rng.integers(468, 660) if rng.random() < 0.8 else rng.integers(1248)
            said[at] = rng.integers(256)
        datagrams = [Datagram(START_NS, of.host, 7788, 7788, said.tobytes())]
        for number, payload in enumerate(sent):
            datagrams.append(Datagram(int(batch.sent_ns[number]), of.host, 6699, 6699, payload.tobytes()))
        write_datagrams(path, datagrams)
        try:
            for cloud in decode_pcap(path, lambda warning: None):
                assert np.isfinite(cloud.xyz).all()
                assert len(cloud.xyz) <= 40 * 384
                assert np.linalg.norm(cloud.xyz, axis=1).max(initial=0) <= MOST_M
                assert cloud.return_type.max(initial=0) <= 3
            good += 1
        except PacketError as error:
            errors.append(str(error))
    assert good
    assert errors
    assert all(str(path) in error and "\n" not in error for error in errors)

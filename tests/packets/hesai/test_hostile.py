"""Packets with octets changed at random: a cloud or one line, never a crash, never points that are not finite."""

from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.ethernet import ethernet_frames
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.errors import PacketError
from lidarcfg.packets.families import codec
from lidarcfg.units import START_NS
from tests.packets.hesai.recorded import mount


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["strongest", "dual"])
@pytest.mark.parametrize("model", ["pandar-xt32", "pandar-xt16", "xt32m2x", "qt128", "ot128"])
def test_changed_octets(model, mode, tmp_path):
    rng = np.random.default_rng(5)
    of = mount(model, mode)
    path = tmp_path / "drive.pcap"
    maker = codec(of.sensor)
    batch = next(maker.schedule(of, START_NS, [range(50)]))
    shape = len(batch.firings.time_ns), 1 + (mode == "dual")
    payloads = maker.encode(of, batch, rng.uniform(1, 40, shape), rng.integers(0, 256, shape, np.uint8))
    most = 65535 * 0.255
    good = 0
    errors = []
    for _ in range(15):
        data = payloads.data.copy()
        head = np.r_[0:12, data.shape[1] - 60 : data.shape[1]]  # what has a meaning besides ranges
        for _ in range(rng.integers(1, 4)):
            column = rng.choice(head) if rng.random() < 0.7 else rng.integers(data.shape[1])
            rows = slice(None) if rng.random() < 0.5 else rng.integers(50)
            data[rows, column] = rng.integers(256)
        write_pcap(path, [ethernet_frames(of.host, replace(payloads, data=data))])
        try:
            for cloud in decode_pcap(path, lambda warning: None):
                assert np.isfinite(cloud.xyz).all()
                assert len(cloud.xyz) <= data.shape[0] * data.shape[1] / 3
                assert abs(cloud.xyz).max(initial=0) <= most
                assert cloud.return_type.max(initial=0) <= 3
            good += 1
        except PacketError as error:
            errors.append(str(error))
    assert good
    assert errors
    assert all(str(path) in error and "\n" not in error for error in errors)

"""Packets with octets changed at random: a cloud or one line, never a crash, never points that are not finite."""

from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.ethernet import ethernet_frames
from lidarcfg.capture.export import save_sidecar_files
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.errors import PacketError
from tests.packets.hesai_at.fixtures import mount, sensed


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["strongest", "dual"])
@pytest.mark.parametrize("model", ["at128e2x", "atx"])
def test_changed_octets(model, mode, tmp_path):
    rng = np.random.default_rng(5)
    of = mount(model, mode)
    path = tmp_path / "drive.pcap"
    *_, payloads = sensed(of, range(30))
    save_sidecar_files(path, [of])
    angles = next(tmp_path.glob("*-angles.dat"))
    whole = angles.read_bytes()
    good = 0
    errors = []
    for turn in range(15):
        data = payloads.data.copy()
        head = np.r_[0:15, data.shape[1] - 80 : data.shape[1]]  # what has a meaning besides ranges
        for _ in range(rng.integers(1, 4)):
            column = rng.choice(head) if rng.random() < 0.7 else rng.integers(data.shape[1])
            rows = slice(None) if rng.random() < 0.5 else rng.integers(len(data))
            data[rows, column] = rng.integers(256)
        write_pcap(path, [ethernet_frames(of.host, replace(payloads, data=data))])
        at = int(rng.integers(len(whole)))
        angles.write_bytes(whole[:at] + bytes([255 - whole[at]]) + whole[at + 1 :] if turn % 5 == 4 else whole)
        try:
            for cloud in decode_pcap(path, lambda warning: None):
                assert np.isfinite(cloud.xyz).all()
                assert abs(cloud.xyz).max(initial=0) <= 65535 * 0.255
                assert cloud.return_type.max(initial=0) <= 3
            good += 1
        except PacketError as error:
            errors.append(str(error))
    assert good
    assert errors
    assert all(str(tmp_path) in error and "\n" not in error for error in errors)

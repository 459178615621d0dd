"""A short run of tools/fuzz.py; docs/evidence/reliability.md has the long one. And what it found, each with a test of its own."""

import gc
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.pcap import Datagram
from lidarcfg.capture.stream import Stream
from lidarcfg.errors import PacketError
from lidarcfg.packets.velodyne.layout import PACKET
from tests.capture_fixtures import AT_NS, no_warning, write_datagrams

pytestmark = pytest.mark.slow

TOOL = Path(__file__).parents[1] / "tools" / "fuzz.py"


@pytest.mark.parametrize(("options", "points_each"), [((), 10), (("--makers",), 1)])
def test_odd_captures_end_well(options, points_each):
    """Six thousand packets of all makers, and of those besides Velodyne, with the kernels that everybody uses."""
    command = [sys.executable, str(TOOL), "--random", "--packets", "6000", "--seed", "7", *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    captures, packets, points, refused = (
        int(number.replace(",", ""))
        for number in re.findall(r"([\d,]+) (?:captures|packets|points|refused)", done.stdout)[:4]
    )
    assert packets >= 6_000
    assert points > points_each * packets  # many are decoded, not refused
    assert 0 < refused < captures


def test_a_refused_capture_leaves_no_packets_behind(tmp_path):
    """Not even until the garbage is collected: a traceback had held the error that held it."""
    packet = np.zeros((), PACKET)  # of no model
    write_datagrams(tmp_path / "a.pcap", [Datagram(AT_NS, "192.168.1.201", 2368, 2368, packet.tobytes())] * 40)
    gc.collect()
    gc.disable()
    try:
        clouds = decode_pcap(tmp_path / "a.pcap", no_warning)
        try:
            pytest.fail(f"decoded: {list(clouds)}")
        except PacketError:
            del clouds
        assert [thing for thing in gc.get_objects() if type(thing) is Stream] == []
    finally:
        gc.enable()

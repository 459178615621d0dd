"""What an AT128 and an ATX answer drivers by PTC: the maker's files as they are, and an inventory."""

import pytest

from lidarcfg.packets.codec import PacketSource
from lidarcfg.packets.emulator import NetworkSite
from lidarcfg.packets.families import codec
from lidarcfg.packets.hesai.at.telemetry import firing_times
from tests.packets.hesai_at.fixtures import mount, sensed

HEAD = bytes.fromhex("4774")


def asked(model, command, beside):
    """The return code and the payload of an answer, by the frame of HesaiLidar_SDK_2.0, PtcParser."""
    of = mount(model, "strongest")
    *_, payloads = sensed(of, range(4))
    source = PacketSource(
        "a.pcap",
        of.host,
        of.data_port,
        lambda suffix: beside,
        lambda port, size: iter(()),
        lambda kind, size: iter(()),
        print,
    )
    emulator = codec(of.sensor).emulator(source, payloads.data, NetworkSite("10.77.0.2", "127.0.0.1", None))
    (service,) = emulator.services
    answer = service.answer(HEAD + bytes([command, 0, 0, 0, 0, 0]), "127.0.0.1").data
    assert answer[:3] == HEAD + bytes([command])
    assert int.from_bytes(answer[4:8], "big") == len(answer) - 8
    return answer[3], answer[8:]


@pytest.mark.parametrize("model", ["at128e2x", "at128e3x", "atx"])
def test_angles_are_the_file(model):
    of = mount(model, "strongest")
    content = of.sensor.pattern.angles.content
    assert asked(model, 0x05, {}) == (0, content)
    other = mount("at128e3x").sensor.pattern.angles.content
    if model == "at128e2x":
        assert asked(model, 0x05, {"a-angles.dat": other}) == (0, other)


def test_firing_times_of_an_atx_alone():
    assert asked("atx", 0xA9, {}) == (0, firing_times(codec(mount("atx").sensor).unit))
    assert asked("at128e2x", 0xA9, {})[0] != 0


def test_inventory_of_an_at128():
    """By Nebula's HesaiInventory_AT128: model 48, one direction, 128 lines, after 104 bytes that all have and 66 more."""
    code, said = asked("at128e2x", 0x07, {})
    assert code == 0
    assert len(said) == 104 + 4 * 16 + 2 + 1 + 1 + 1 + 1 + 1 + 9
    assert list(said[104 + 66 :][:3]) == [48, 0, 128]

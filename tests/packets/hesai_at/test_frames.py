"""A capture's frames: a facet of an AT128's mirror is one, a swing of an ATX's, there or back."""

import numpy as np
import pytest

from lidarcfg.capture.revolutions import revolutions
from lidarcfg.units import START_NS
from tests.capture_fixtures import no_warning
from tests.packets.hesai_at.fixtures import mount, written


@pytest.mark.parametrize(("model", "slots", "frames"), [("at128e3x", 1300, 2), ("atx", 1550, 3)])
def test_frames_begin_every_100_ms(model, slots, frames, tmp_path):
    """Slots are of 83,333 and of 133,333 ns: by hand, so many frames have begun."""
    path = tmp_path / "drive.pcap"
    _, range_m, *_ = written(mount(model, "strongest"), path, range(slots))
    clouds = list(revolutions(path, no_warning))
    numbers = [np.unique((cloud.time_ns - START_NS) // 100_000_000) for cloud in clouds]
    assert [one.tolist() for one in numbers] == [[k] for k in range(frames)]
    assert sum(len(cloud.xyz) for cloud in clouds) == np.isfinite(range_m).sum()

"""Four frames of ouster-sdk's live source, from a sensor that answers at an address: ADDRESS FILE.npz."""

import contextlib
import itertools
import sys

import numpy as np
from ouster.sdk import core, open_source

address, path = sys.argv[1:]
with contextlib.closing(open_source(address, lidar_port=0, imu_port=0)) as source:
    found = [frames[0] for frames in itertools.islice(source, 4)]
    info = source.sensor_info[0]
whole = found[2]  # the source may have begun within the first one
np.savez(
    path,
    frame_id=[frame.frame_id for frame in found],
    timestamp=[frame.timestamp for frame in found],
    xyz=core.XYZLut(info)(whole)[whole.field("RANGE") > 0],
    metadata=info.to_json_string(),
)

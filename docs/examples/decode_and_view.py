"""Decoding a capture, ours or a real sensor's, and looking at the points.

.venv/bin/python docs/examples/decode_and_view.py
"""

from pathlib import Path

import numpy as np

import lidarcfg
from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.clouds.cloud import concatenate, load_cloud, save_clouds
from lidarcfg.viewer.contents import Contents
from lidarcfg.viewer.page import page_of, save_html
from lidarcfg.viewer.still import save_still

out = Path("out/examples")
out.mkdir(parents=True, exist_ok=True)

# %% A capture
# Two sensors in a street, for a tenth of a second. A recording of a real Velodyne does as well.
rig, scene = lidarcfg.load_rig("data/rigs/roof.yaml"), lidarcfg.load_scene("data/scenes/street.yaml")
capture = out / "turn.pcap"
write_pcap(capture, in_time_order(simulated_packets(rig, scene, np.eye(4), duration_ns=100_000_000)))

# %% Its points
# With a rig the points of all sensors are in the vehicle's frame; without one each sensor's are in its own. They come
# in pieces, so that long captures need no more memory than short ones. What is odd about a file is printed.
cloud = concatenate(list(decode_pcap(capture, print, rig)))
for i, name in enumerate(cloud.sensor_names):
    mine = cloud.xyz[cloud.sensor == i]
    print(f"{name:6} {len(mine):,} points, the furthest {np.linalg.norm(mine, axis=1).max():.1f} m away")
assert cloud.sensor_names == ("left", "right")

# %% What each point knows
# Place, intensity, ring, time in nanoseconds since 1970, sensor, and which return of a pair it is.
first = int(np.argmin(cloud.time_ns))
print(cloud.xyz[first], cloud.intensity[first], cloud.ring[first], cloud.time_ns[first], cloud.return_type[first])
ground = np.abs(cloud.xyz[:, 2]) < 0.01
print(f"{ground.mean():.0%} of the points are on the ground")
assert 0.1 < ground.mean() < 0.5

# %% Saved and loaded again
# .npz and .pcd keep all of it as it is, .ply too: position, intensity, ring, exact time, sensor.
save_clouds(out / "turn.ply", [cloud])
again = load_cloud(out / "turn.ply", print)
assert np.array_equal(again.xyz, cloud.xyz)
assert np.array_equal(again.time_ns, cloud.time_ns)

# %% A picture and a page
# The page is one file that opens in any browser, without a server or a network.
contents = Contents(cloud, objects=None, rigs=(rig,), study=None, scenes=(scene,), T_world_vehicle=np.eye(4))
save_still(contents, out / "turn.png", (960, 540), by="height")
save_html(page_of(contents, by="height"), out / "turn.html")
print(f"{out}/turn.png and {out}/turn.html, {(out / 'turn.html').stat().st_size / 1e6:.1f} MB")

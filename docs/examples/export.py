"""Exporting: the packets that a rig's sensors would send in a scene, and the truth about them.

.venv/bin/python docs/examples/export.py
"""

from pathlib import Path

import numpy as np

import lidarcfg
from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.ground_truth import TruthFile
from lidarcfg.capture.pcap import read_datagrams, write_pcap

out = Path("out/examples")
out.mkdir(parents=True, exist_ok=True)

# %% A rig, a scene, and where the vehicle stands in it
rig = lidarcfg.load_rig("data/rigs/roof.yaml")
scene = lidarcfg.load_scene("data/scenes/street.yaml")
T_world_vehicle = lidarcfg.pose((2.0, 0.0, 0.0), (0.0, 0.0, np.radians(10)))
print(f"{len(rig.mounts)} sensors among {len(scene.names)} objects of {len(scene.triangles):,} triangles")

# %% A tenth of a second: one turn of the heads
# There is a stream for each sensor; merged by time they make one capture. Both are read as they are needed, so an hour
# takes no more memory than a second. The truth of each return is told as it is made.
names = [mount.name for mount in rig.mounts]
with TruthFile(out / "street.npz", names, scene.names) as truth:
    streams = simulated_packets(rig, scene, T_world_vehicle, duration_ns=100_000_000, on_truth=truth.add)
    packets = write_pcap(out / "street.pcap", in_time_order(streams))
    returns = truth.save()
print(f"{packets} packets, {returns:,} returns")

# %% What is in the file
# Data packets of 1206 bytes and position packets of 512, as from the real sensors, in the order of time.
datagrams = list(read_datagrams(out / "street.pcap", print))
sizes, counts = np.unique([len(datagram.payload) for datagram in datagrams], return_counts=True)
print(dict(zip(sizes.tolist(), counts.tolist(), strict=True)))
assert sizes.tolist() == [512, 1206]
assert np.all(np.diff([datagram.time_ns for datagram in datagrams]) >= 0)

# %% What the returns are of
with np.load(out / "street.npz") as told:
    met, often = np.unique(told["object"], return_counts=True)
for index in np.argsort(-often)[:5]:
    print(f"{often[index]:6,} returns of {scene.names[met[index]]}")
assert often.sum() == returns

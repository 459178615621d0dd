"""Writing a scene: what stands around the vehicle.

.venv/bin/python docs/examples/scene.py
"""

from pathlib import Path

import numpy as np

import lidarcfg
from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.clouds.cloud import concatenate
from lidarcfg.errors import LidarcfgError

out = Path("out/examples")
out.mkdir(parents=True, exist_ok=True)

# %% Ground, a wall and a sign
# Metres; x forward, y left, z up. Reflectivity is in per cent up to 100, above that a retro-reflector's.
text = """
name: wall
ground: {z_m: 0, reflectivity: 12}
boxes:
  - {name: wall, center_m: [10.5, 0, 2], size_m: [1, 40, 4], reflectivity: 40}
planes:
  - {name: sign, center_m: [8, 0, 2], size_m: [1, 1], rpy_deg: [0, 90, 0], reflectivity: 210}
"""
(out / "wall.yaml").write_text(text)
scene = lidarcfg.load_scene(out / "wall.yaml")
print(dict(zip(scene.names, scene.reflectivity.tolist(), strict=True)))

# %% What two sensors see of it
rig = lidarcfg.load_rig("data/rigs/roof.yaml")
write_pcap(out / "wall.pcap", in_time_order(simulated_packets(rig, scene, np.eye(4), duration_ns=100_000_000)))
cloud = concatenate(list(decode_pcap(out / "wall.pcap", print, rig)))
for name, reflectivity in zip(scene.names, scene.reflectivity, strict=True):
    print(f"{(cloud.intensity == reflectivity).sum():6,} returns of the {name}")

# %% The wall's face is 10 m ahead, the sign hangs 2 m before it
front = cloud.xyz[(cloud.intensity == 40) & (np.abs(cloud.xyz[:, 1]) < 15) & (cloud.xyz[:, 2] < 3.9)]
sign = cloud.xyz[cloud.intensity == 210]
print(f"wall at x = {front[:, 0].mean():.4f} m, sign at x = {sign[:, 0].mean():.4f} m")
assert np.allclose(front[:, 0], 10, atol=0.002)
assert np.allclose(sign[:, 0], 8, atol=0.002)

# %% A mistake is told in one line
(out / "bad.yaml").write_text(text.replace("size_m: [1, 40, 4]", "size: [1, 40, 4]"))
try:
    lidarcfg.load_scene(out / "bad.yaml")
except LidarcfgError as error:
    print(error)

"""Adding a sensor: a YAML file, and it can be placed, fired and decoded.

.venv/bin/python docs/examples/sensor.py
"""

from pathlib import Path

import numpy as np
import yaml

import lidarcfg
from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.clouds.cloud import concatenate
from lidarcfg.sensors.sensor import catalogue

out = Path("out/examples")
out.mkdir(parents=True, exist_ok=True)

# %% The sensors that are there
for name in catalogue():
    sensor = lidarcfg.load_sensor(name)
    if elevation := sensor.beams.elevation_deg:  # none where a scan pattern says where each firing goes
        print(f"{name:12} {sensor.count:3} beams, {min(elevation):6.2f}° to {max(elevation):5.2f}°")

# %% A new one
# A VLP-16 whose beams are steeper, and another product id. Everything else is as the VLP-16 has it.
facts = yaml.safe_load(catalogue()["vlp-16"].read_text())
facts["name"] = "steep-16"
facts["beams"] = {"elevation_deg": [-30, 0, -26, 2, -22, 4, -18, 6, -14, 8, -10, 10, -6, 12, -3, 14]}
facts["velodyne"]["packet"] |= {"product_id": 0x77, "old_product_ids": []}
(out / "steep-16.yaml").write_text(yaml.safe_dump(facts))
steep = lidarcfg.load_sensor(out / "steep-16.yaml")
assert steep.count == 16

# %% On a rig
# A path stands wherever a model's name could, relative to the file it stands in.
mount = {"name": "top", "model": "steep-16.yaml", "position_m": [0, 0, 1.9]}
(out / "steep.yaml").write_text(yaml.safe_dump({"name": "steep", "sensors": [mount]}))
rig = lidarcfg.load_rig(out / "steep.yaml")

# %% What it sends, and what comes back
# In the open, on flat ground: each ring that points down is a circle of radius 1.9 m / tan(angle).
(out / "field.yaml").write_text("name: field\nground: {reflectivity: 12}\n")
field = lidarcfg.load_scene(out / "field.yaml")
write_pcap(out / "steep.pcap", in_time_order(simulated_packets(rig, field, np.eye(4), duration_ns=100_000_000)))
cloud = concatenate(list(decode_pcap(out / "steep.pcap", print, rig)))
for ring, angle in enumerate(sorted(steep.beams.elevation_deg)):
    radius = np.hypot(*cloud.xyz[cloud.ring == ring, :2].T)
    if len(radius):
        print(f"{angle:4}°: {len(radius):,} points on a circle of {radius.mean():6.3f} m")
        assert np.allclose(radius, 1.9 / np.tan(np.radians(-angle)), atol=0.002)
assert set(cloud.ring.tolist()) == {ring for ring, angle in enumerate(sorted(steep.beams.elevation_deg)) if angle < 0}

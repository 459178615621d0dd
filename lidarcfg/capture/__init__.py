"""Captures: files of packets, read and written.

To read in this order. From a capture down to its bytes: `decode` turns a capture into points, `reader` gives the
packets of each sensor, `source_finder` says whose they are, `stream` puts them in order; `pcap`, `ethernet` and
`fragments` read the files, `selection` skips what is not wanted. `revolutions` cuts the points into these.

The other way: `export` gives what the sensors of a rig send in a scene, `ground_truth` what each return hit, and `wire`
what of it is lost or late; `writer` sends the same from the scenes of others, who may say where the vehicle was:
`pose_log`. `manifest` names the inputs of a capture, and `manifest_writer` writes it.

Over the network: `sender` sends datagrams at their times, `replay` those of a capture, `live` those of a rig in a scene
while `live_packets` has them made; `pose_reader` reads where its vehicle and objects are to go. Meanwhile `emulation`
finds the sensors that answer drivers, and `emulation_server` answers on their ports.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

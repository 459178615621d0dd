"""The makers' packets, a folder each: `layout`, `model`, `encode`, `decode`, `telemetry`.

To read in this order: `codec` is the interface that each maker implements, `families` the registry of them; `rotating`,
`blocks`, `inertial`, `network` and `unit` are what several share, `generic` the firings of sensors without packets.
"""

"""Scenarios: a moving target is detected in time to brake.

To read in this order: `file` is a scenario as files say it, `approach` says where vehicle, target and parked cars are
at each time and when braking must begin, `run` what the sensors see in each frame, and whether that is in time. `sight`
says when the target could first be seen. `requirement` is the kind of requirement, and judges rigs by it.
"""

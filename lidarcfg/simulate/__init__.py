"""What a rig's sensors report in a scene.

To read in this order: `tasks` says what is fired when, `simulator` what each beam hits, `echoes` what a beam of some
width makes of it, `noise` how far off it is reported, `scans` and `ground_truth` what that is as points, `export` as
packets.
"""

"""What a rig must see, and whether it does.

To read in this order: `braking` says when braking must begin, `scenario` where vehicle, target and parked cars are,
`sight` from when on anything could be seen, `detection` when the sensors see it.
"""

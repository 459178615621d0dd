"""Scenarios in plain loops, from the words of docs/scenarios.md: where target and cars are, when braking must begin.

Distances are along the vehicle's path from where its front is at the impact (backwards: its rear), and to the left of
the middle of the path; times are seconds before the impact.
"""

import math

STEP_S = 5e-4


def walked(way_m, gain_m, speed_m_s, before_s):
    """How far a target still has to go, stepped backwards from the impact: steady, then losing its speed over gain_m."""
    left = 0.0
    speed = speed_m_s
    for _ in range(round(before_s / STEP_S)):
        beyond = left - (way_m - gain_m)
        if beyond > 0:
            speed = speed_m_s * math.sqrt(max(1 - beyond / gain_m, 0.0))  # v² grows evenly with the way
        left = min(left + speed * STEP_S, way_m)
    return left


def last_moment(speed_m_s, reaction_s, braking_m_s2, offset_m=0.0, ahead_m_s=0.0):
    """Seconds before the impact at which braking must begin, tried in small steps: the brakes then stop it just in time.

    The target keeps its speed; the vehicle slows down to it.
    """
    before = 0.0
    while True:
        gap = (speed_m_s - ahead_m_s) * before
        speed = speed_m_s
        since = 0.0
        while speed > ahead_m_s:
            gap -= (speed - ahead_m_s) * 1e-3
            if since >= reaction_s:
                speed -= braking_m_s2 * 1e-3
            since += 1e-3
        if gap >= offset_m:
            return before
        before += 0.01


def shows(speed_m_s, walk_m_s, half_length_m, ahead_m, beside_m, across_m, way_m, gain_m):
    """At which distance a walker's leading face comes out of the shadow of a parked car's corner.

    The corner is `ahead_m` before the face's seen edge along the path and `beside_m` right of the path's middle; the
    eye is `across_m` left of it at the vehicle's front, `ahead_m` is measured from the face to the corner, and the
    front is one step closer each time.
    """
    before = 0.0
    edge_beyond_line_m, corner_before_edge_m = ahead_m
    while True:  # from the impact backwards, until it is hidden
        distance = speed_m_s * before
        face = -walked(way_m, gain_m, walk_m_s, before) + half_length_m
        to_corner = distance - (corner_before_edge_m - edge_beyond_line_m)
        if to_corner > 0:
            shadow = -beside_m - (across_m + beside_m) / to_corner * corner_before_edge_m
            if face < shadow:
                return distance
        before += 0.005


def seen_before(returns, frame_s, lead_s, needed_s, demanded):
    """Seconds before the impact from which on a target is seen, walked back from the last moment to brake; None: never.

    A frame counts at its end. What is not seen then is looked for after it, forwards to the impact.
    """
    frames = len(returns)
    last = 0
    while last < frames and (last + 1) * frame_s <= lead_s - needed_s:
        last += 1  # frames that end in time
    seen = None
    for number in range(last, 0, -1):
        if returns[number - 1] < demanded:
            break
        seen = number
    if seen is None:
        for number in range(last + 1, frames + 1):
            if returns[number - 1] >= demanded:
                seen = number
                break
    return None if seen is None else lead_s - seen * frame_s


def up_to(passed):
    """The highest of the speeds, lowest first, before the first at which it fails; `passed` by speed; None: none."""
    highest = None
    for speed in sorted(passed):
        if not passed[speed]:
            break
        highest = speed
    return highest

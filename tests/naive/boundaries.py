"""Plain-loop twin of where lines come into what a LiDAR sees, and leave it: by steps, bisection and differences."""

import math

from tests.naive.vectors import cross, dot, minus


def through_triangle(start, way, corners):
    """Whether the segment start … start + way passes through a triangle (Möller and Trumbore 1997)."""
    one, other = minus(corners[1], corners[0]), minus(corners[2], corners[0])
    p = cross(way, other)
    volume = dot(one, p)
    if volume == 0:
        return False
    t = minus(start, corners[0])
    q = cross(t, one)
    u = dot(t, p) / volume
    v = dot(way, q) / volume
    s = dot(other, q) / volume
    return u >= 0 and v >= 0 and u + v <= 1 and 0 < s < 1


def within_disc(start, way, centre, radius, axes):
    """From where to where along start + s · way some coordinates are within a radius of a centre; None: nowhere."""
    a = sum(way[n] ** 2 for n in axes)
    b = sum(way[n] * (start[n] - centre[n]) for n in axes)
    c = sum((start[n] - centre[n]) ** 2 for n in axes) - radius**2
    if a == 0:
        return (-math.inf, math.inf) if c <= 0 else None
    if b * b < a * c:
        return None
    root = math.sqrt(b * b - a * c)
    return (-b - root) / a, (-b + root) / a


def through_round(start, way, shape):
    """Whether a segment passes through the surface of a sphere, or of an upright cylinder (x, y, z, radius, height)."""
    x, y, z, radius, height = shape
    if math.isnan(height):
        span = within_disc(start, way, (x, y, z), radius, (0, 1, 2))
    else:
        span = within_disc(start, way, (x, y, z), radius, (0, 1))
        if span and way[2] == 0:
            span = span if z <= start[2] <= z + height else None
        elif span:
            heights = sorted(((z - start[2]) / way[2], (z + height - start[2]) / way[2]))
            span = max(span[0], heights[0]), min(span[1], heights[1])
    return span is not None and span[0] <= span[1] and any(0 < s < 1 for s in span)


def sees(point, sensor, triangles, rounds, ground):
    """Whether a sensor {position, x, y, range, fov in degrees, clockwise} sees a point past bodies."""
    way = minus(point, sensor["position"])
    if not sensor["range"][0] <= math.hypot(*way) <= sensor["range"][1]:
        return False
    low, high = sensor["fov"]
    clockwise = -math.degrees(math.atan2(dot(way, sensor["y"]), dot(way, sensor["x"])))
    if (high - low) % 360 and (clockwise - low) % 360 > (high - low) % 360:
        return False
    if min(point[2], sensor["position"][2]) < ground < max(point[2], sensor["position"][2]):
        return False
    start = sensor["position"]
    if any(through_triangle(start, way, corners) for corners in triangles):
        return False
    return not any(through_round(start, way, shape) for shape in rounds)


def flips(see, u, v, low, high, steps):
    """Where see(s, u, v) changes along a line, by steps and bisection: the first state, and the places."""
    places = [low + (high - low) * (i + 0.5) / steps for i in range(steps)]
    states = [see(s, u, v) for s in places]
    found = [bisected(see, u, v, places[i - 1], places[i]) for i in range(1, steps) if states[i] != states[i - 1]]
    return states[0], found


def bisected(see, u, v, low, high):
    """Where between two places with different states the state changes."""
    first = see(low, u, v)
    while True:
        middle = (low + high) / 2
        if not low < middle < high:
            return middle
        low, high = (middle, high) if see(middle, u, v) == first else (low, middle)


def steepness(see, u, v, place, reach, step=1e-5):
    """|n·e| of the surface that a line crosses at a place, by where four lines beside it cross it; None: they do not."""
    first, last = see(place - reach, u, v), see(place + reach, u, v)
    beside = [(u + step, v), (u - step, v), (u, v + step), (u, v - step)]
    if first == last or any((see(place - reach, *at), see(place + reach, *at)) != (first, last) for at in beside):
        return None
    right, left, up, down = [bisected(see, *at, place - reach, place + reach) for at in beside]
    return 1 / math.hypot(1, (right - left) / (2 * step), (up - down) / (2 * step))

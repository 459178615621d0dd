"""The compiled loops of returns: the rays of a revolution that may hit an object at a place, and which do.

Of a sensor's rays only those are traced that point at the object's bounding box: their numbers follow from the box's
azimuths and slopes. They are traced in the object's frame, where its tree is built once for all places; what hits is
then asked whether anything stands in between.
"""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import inner, njit
from lidarcfg.world.bvh import EMPTY, Tree
from lidarcfg.world.ray_kernels import NONE, RANGE, SIZE, SLOT, alike, load, made_packet
from lidarcfg.world.shapes import FAST
from lidarcfg.world.tracer_kernels import blocked, trace

Counts = NDArray[np.int32]
TURN = 2 * math.pi
AHEAD_M = 1e-9  # an object's corners are all at least so far ahead of a sensor, or rays all around are traced
WIDER = 1e-9  # of azimuths and slopes, for rounding
FOV_RAD = 1e-11  # by which a field of view is wider, for rounding
BEYOND_M = 1.0  # beyond the greatest range nothing is a return; rays are traced this much farther
ALL = 2**31 - 1  # no end to the returns that are counted
HELD = 256  # hits that are asked together for what stands in between


class Scans(NamedTuple):
    """The revolutions of S sensors in flat columns, whatever their poses."""

    first_head: NDArray[np.int64]  # (S + 1,)
    cos_head: Array  # (H,) of where heads are at the start of cycles, of all phases, ascending
    sin_head: Array
    start_rad: Array  # (S,) of the first head
    fine_rad: Array  # (S,) from one head to the next
    phases: NDArray[np.int64]  # (S,) head n of a sensor is of phase n % phases
    first_firing: NDArray[np.int64]  # (S + 1,)
    lag_rad: Array  # (F,) from the head's start to the encoder's angle at each firing
    decides_rad: Array  # (F,) and to the angle that decides whether it is in the field of view
    offset_rad: Array  # (F,) from the encoder's angle to the beam's azimuth
    elevation_rad: Array  # (F,)
    start_m: Array  # (F, 3) where the beam starts: forward, left, up
    range_m: Array  # (S, 2) least, greatest
    fov_rad: Array  # (S, 2) from, width


class Poses(NamedTuple):
    """Where S sensors are in the vehicle frame."""

    R: Array  # (S, 3, 3)
    t: Array  # (S, 3)


class Shape(NamedTuple):
    """An object in its own frame."""

    tree: Tree
    low_m: Array  # (3,) corners of its bounding box
    high_m: Array


class Frame(NamedTuple):
    """An object at a place, as seen from a sensor."""

    M: Array  # (3, 3) from the sensor's frame into the object's
    origin: Array  # (3,) where the sensor is in the object's frame
    R: Array  # (3, 3) from the object's frame into the vehicle's
    t: Array  # (3,)


class Work(NamedTuple):
    """Working memory of a thread."""

    origins: Array  # (3, SIZE) of a packet
    directions: Array
    starts: Array  # (3, HELD) of hits, in the vehicle frame
    ways: Array  # (3, HELD) to where they are
    hit_phase: NDArray[np.int64]  # (HELD,)
    hidden: NDArray[np.bool_]  # (HELD,)


@inner(makes_arrays=True)
def new_work():
    """Working memory."""
    return Work(
        np.zeros((3, SIZE)),
        np.zeros((3, SIZE)),
        np.zeros((3, HELD)),
        np.zeros((3, HELD)),
        np.zeros(HELD, np.int64),
        np.zeros(HELD, np.bool_),
    )


@njit(cache=True, nogil=True)
def window(shape, M, origin, beside_m):
    """Where in a sensor's frame an object's bounding box is seen, from up to `beside_m` beside the axis.

    M (3, 3) rotates the sensor's frame into the object's, in which the sensor is at `origin` (3,). Returns the
    azimuths, clockwise, from and to; least and greatest distance from the axis; least and greatest height. A least
    distance of 0 says that the box may be all around.
    """
    x, y, z = np.empty(8), np.empty(8), np.empty(8)
    for c in range(8):
        a = (shape.high_m[0] if c & 1 else shape.low_m[0]) - origin[0]
        b = (shape.high_m[1] if c & 2 else shape.low_m[1]) - origin[1]
        d = (shape.high_m[2] if c & 4 else shape.low_m[2]) - origin[2]
        x[c] = M[0, 0] * a + M[1, 0] * b + M[2, 0] * d
        y[c] = M[0, 1] * a + M[1, 1] * b + M[2, 1] * d
        z[c] = M[0, 2] * a + M[1, 2] * b + M[2, 2] * d
    u, v = x.mean(), y.mean()
    length = math.sqrt(u * u + v * v)
    if length == 0:
        return 0.0, TURN, 0.0, math.inf, z.min(), z.max()
    u, v = u / length, v / length
    near, far, left, right = math.inf, 0.0, 0.0, 0.0
    for c in range(8):
        ahead, aside = x[c] * u + y[c] * v, y[c] * u - x[c] * v
        near, far = min(near, ahead), max(far, math.sqrt(x[c] * x[c] + y[c] * y[c]))
        if ahead > 0:
            angle = math.atan2(aside, ahead)
            left, right = max(left, angle), min(right, angle)
    if near <= beside_m + AHEAD_M:
        return 0.0, TURN, 0.0, math.inf, z.min(), z.max()
    centre, wider = -math.atan2(v, u), math.asin(beside_m / near) + WIDER
    return centre - left - wider, centre - right + wider, near - beside_m, far + beside_m, z.min(), z.max()


@inner()
def between(low_m, high_m, near_m, far_m, elevation_rad):
    """Whether a beam that rises so may be at a height within limits at a distance within limits."""
    if near_m == 0:
        return True
    if abs(elevation_rad) > 1.5:  # nearly along the axis, from which the object stays away
        rise = math.tan(min(max(elevation_rad, -1.5707963), 1.5707963))
        return rise * near_m <= high_m if rise > 0 else rise * near_m >= low_m
    rise = math.tan(elevation_rad)
    least = low_m / (near_m if low_m < 0 else far_m)
    most = high_m / (far_m if high_m < 0 else near_m)
    return least - WIDER * (1 + abs(least)) <= rise <= most + WIDER * (1 + abs(most))


@inner(fastmath=FAST)
def aim(scans, f, head, count, M, origin, origins, directions):
    """Write the rays of firing f at heads `head` to `head` + count, in the object's frame."""
    cos_heads, sin_heads = scans.cos_head, scans.sin_head
    lag, offset, elevation = scans.lag_rad[f], scans.offset_rad[f], scans.elevation_rad[f]
    forward, left, above = scans.start_m[f, 0], scans.start_m[f, 1], scans.start_m[f, 2]
    cos_l, sin_l, cos_o, sin_o = math.cos(lag), math.sin(lag), math.cos(offset), math.sin(offset)
    cos_w, sin_w = math.cos(elevation), math.sin(elevation)
    for k in range(3):
        u, v, w, start = M[k, 0], M[k, 1], M[k, 2], origin[k]
        for n in range(count):
            cos_h, sin_h = cos_heads[head + n], sin_heads[head + n]
            cos_e, sin_e = cos_h * cos_l - sin_h * sin_l, sin_h * cos_l + cos_h * sin_l
            c, s = cos_e * cos_o - sin_e * sin_o, sin_e * cos_o + cos_e * sin_o
            directions[k, n] = u * (cos_w * c) - v * (cos_w * s) + w * sin_w
            origins[k, n] = u * (left * s + forward * cos_e) + v * (left * c - forward * sin_e) + (w * above + start)


@inner()
def outside(scans, s, f, head):
    """Whether a firing of sensor s at one of its heads is outside its field of view."""
    width = scans.fov_rad[s, 1]
    if width >= TURN:
        return False
    turned = (scans.start_rad[s] + head * scans.fine_rad[s] + scans.decides_rad[f] - scans.fov_rad[s, 0]) % TURN
    return width + FOV_RAD < turned < TURN - FOV_RAD


@inner(makes_arrays=True)
def settle(obstacles, packet, work, held, counts):
    """Count those of the hits held that nothing stands before, by phase."""
    hidden, phase, starts, ways = work.hidden, work.hit_phase, work.starts, work.ways
    hidden[:held] = False
    if held and obstacles.tree.root != EMPTY:
        blocked(obstacles.tree, packet, starts, ways, held, hidden)
    ground_m = obstacles.ground_m - obstacles.origin_m[2]
    for n in range(held):
        one, other = starts[2, n], starts[2, n] + ways[2, n]
        counts[phase[n]] += not (hidden[n] or min(one, other) < ground_m < max(one, other))


@njit(cache=True, nogil=True)
def hold(scans, s, f, head, done, count, obstacles, frame, packet, work, held):
    """Hold which of a packet's `count` rays hit, from head `head` on, for `settle`; returns how many are held then.

    The rays are those of work from `done` on.
    """
    rays, starts, ways, phases, origin = packet.rays, work.starts, work.ways, work.hit_phase, obstacles.origin_m
    least_m, most_m, limited = scans.range_m[s, 0], scans.range_m[s, 1], scans.fov_rad[s, 1] < TURN
    for n in range(count):
        far = rays[RANGE + n]
        if rays[SLOT + n] == NONE or not least_m <= far <= most_m or (limited and outside(scans, s, f, head + n)):
            continue
        for k in range(3):
            a, b, c = work.origins[0, done + n], work.origins[1, done + n], work.origins[2, done + n]
            u, v, w = work.directions[0, done + n], work.directions[1, done + n], work.directions[2, done + n]
            starts[k, held] = frame.R[k, 0] * a + frame.R[k, 1] * b + frame.R[k, 2] * c + (frame.t[k] - origin[k])
            ways[k, held] = (frame.R[k, 0] * u + frame.R[k, 1] * v + frame.R[k, 2] * w) * far
        phases[held] = (head + n) % scans.phases[s]
        held += 1
    return held


@inner(makes_arrays=True)
def trace_heads(scans, s, f, first, end, shape, obstacles, frame, packet, work, held, counts):
    """Trace the rays of a firing of sensor s at its heads `first` to `end`; returns how many hits are held then."""
    rays, most_m, begin = packet.rays, scans.range_m[s, 1], scans.first_head[s]
    while first < end:
        if held + SIZE > HELD:
            settle(obstacles, packet, work, held, counts)
            held = 0
        count, done = min(SIZE, end - first), 0
        aim(scans, f, begin + first, count, frame.M, frame.origin, work.origins, work.directions)
        while done < count:
            some, face = alike(work.directions, done, count)
            load(rays, packet.slabs, work.origins, work.directions, done, some, face)
            for n in range(SIZE):
                rays[RANGE + n] = most_m + BEYOND_M
            trace(shape.tree, packet, face, False)
            held = hold(scans, s, f, first + done, done, some, obstacles, frame, packet, work, held)
            done += some
        first += count
    return held


@njit(cache=True, nogil=True)
def put(frame, place, R, t):
    """Write the frame of an object that stands at a place: x, y, z, heading; as a sensor at a pose sees it."""
    c, s = math.cos(place[3]), math.sin(place[3])
    x, y = t[0] - place[0], t[1] - place[1]
    frame.origin[0], frame.origin[1], frame.origin[2] = c * x + s * y, c * y - s * x, t[2] - place[2]
    for k in range(3):
        frame.M[0, k] = c * R[0, k] + s * R[1, k]
        frame.M[1, k] = c * R[1, k] - s * R[0, k]
        frame.M[2, k] = R[2, k]
        frame.t[k] = place[k]
    frame.R[0, 0], frame.R[0, 1], frame.R[1, 0], frame.R[1, 1], frame.R[2, 2] = c, -s, s, c, 1.0


@inner(makes_arrays=True)
def count_returns(scans, s, shape, obstacles, frame, packet, work, enough, counts):
    """Add to counts (phases,) the returns of sensor s from an object in a frame; ends once all of them are enough."""
    beside_m, held, start = 0.0, 0, scans.start_m
    for f in range(scans.first_firing[s], scans.first_firing[s + 1]):
        beside_m = max(beside_m, math.sqrt(start[f, 0] * start[f, 0] + start[f, 1] * start[f, 1]))
    first_rad, last_rad, near_m, far_m, low_m, high_m = window(shape, frame.M, frame.origin, beside_m)
    heads, fine_rad = scans.first_head[s + 1] - scans.first_head[s], scans.fine_rad[s]
    for f in range(scans.first_firing[s], scans.first_firing[s + 1]):
        if not between(low_m - start[f, 2], high_m - start[f, 2], near_m, far_m, scans.elevation_rad[f]):
            continue
        begin = (first_rad - scans.offset_rad[f] - scans.lag_rad[f] - scans.start_rad[s]) % TURN
        end = begin + (last_rad - first_rad)
        if end - begin >= TURN:
            begin, end = 0.0, TURN
        first, last = math.ceil(begin / fine_rad), min(math.floor(end / fine_rad) + 1, heads)
        held = trace_heads(scans, s, f, first, last, shape, obstacles, frame, packet, work, held, counts)
        if end > TURN:
            last = min(math.floor((end - TURN) / fine_rad) + 1, first)
            held = trace_heads(scans, s, f, 0, last, shape, obstacles, frame, packet, work, held, counts)
        if enough < ALL and held:
            settle(obstacles, packet, work, held, counts)
            held = 0
            if counts.min() >= enough:
                break
    settle(obstacles, packet, work, held, counts)


@njit(cache=True, nogil=True)
def returns(places, scans, poses, shape, obstacles, which, out):
    """Write the returns from an object at some of places (P, 4), to out (P, sensors, phases), of zeros."""
    packet, work, sensors = made_packet(0), new_work(), len(scans.phases)
    frame = Frame(np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3)), np.zeros(3))
    for p in which:
        for s in range(sensors):
            put(frame, places[p], poses.R[s], poses.t[s])
            count_returns(scans, s, shape, obstacles, frame, packet, work, ALL, out[p, s, : scans.phases[s]])


@njit(cache=True, nogil=True)
def probability(counts, phases, enough, chance):
    """The probability of `enough` returns in all, where each sensor is in any of its phases, whatever the others'.

    counts (S, K) of the returns of S sensors, of which sensor s has phases[s]; chance (enough + 1,) is overwritten.
    """
    least, most = 0, 0
    for s in range(len(phases)):
        least, most = least + counts[s, : phases[s]].min(), most + counts[s, : phases[s]].max()
    if least >= enough or most < enough:
        return 1.0 if least >= enough else 0.0
    chance[:] = 0.0
    chance[0] = 1.0  # of exactly so many returns; the last: of so many or more
    for s in range(len(phases)):
        for had in range(enough - 1, -1, -1):
            part = chance[had] / phases[s]
            if part == 0.0:
                continue
            chance[had] = 0.0
            for j in range(phases[s]):
                chance[min(had + counts[s, j], enough)] += part
    return chance[enough]


@njit(cache=True, nogil=True)
def undetected(places, scans, poses, shape, obstacles, enough, most):
    """In how many of places (P, 4) an object goes undetected, by the mean over phases; ends early from `most` on.

    It is detected by `enough` returns. A place is settled as soon as they are certain.
    """
    packet, work, sensors = made_packet(0), new_work(), len(scans.phases)
    frame = Frame(np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3)), np.zeros(3))
    counts, chance, missed = np.zeros((sensors, scans.phases.max()), np.int32), np.zeros(enough + 1), 0.0
    for p in range(len(places)):
        counts[:], certain = 0, 0
        for s in range(sensors):
            put(frame, places[p], poses.R[s], poses.t[s])
            row = counts[s, : scans.phases[s]]
            count_returns(scans, s, shape, obstacles, frame, packet, work, enough - certain, row)
            certain += row.min()
            if certain >= enough:
                break
        if certain < enough:
            missed += 1.0 - probability(counts, scans.phases, enough, chance)
        if missed >= most:
            break
    return missed


@njit(cache=True, nogil=True)
def probabilities(counts, phases, enough):
    """(P,) `probability` of counts (P, S, K)."""
    out, chance = np.empty(len(counts)), np.zeros(enough + 1)
    for p in range(len(counts)):
        out[p] = probability(counts[p], phases, enough, chance)
    return out

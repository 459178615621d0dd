"""The echoes of wide beams: what their rays hit, merged where the sensor cannot tell it apart."""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
import math

import numpy as np

from lidarcfg.jit import inner, njit

DIFFUSE_MAX = 100  # a reflectivity beyond is a retro-reflector's
SEPARATION_M = 1.0  # closer echoes merge (VLP-16 and VLS-128 manuals: dual returns are at least 1 m apart)
FAINTEST = 1e-30  # power of an echo from a black or edge-on surface: detected unless there is a detection limit
NOTHING = -1  # an object
ALBEDO = np.arange(256) / 100  # of a reflectivity
TOTAL, MEAN, SHINE, BEST, OWNER = range(5)  # rows of the echoes of a beam


@inner()
def _sort(range_m, order):
    """Sort the rays of a beam by range; of equal ones, by number. Quick where the order is right already."""
    for i in range(1, len(order)):
        k, at = order[i], i
        while at > 0 and (
            range_m[order[at - 1]] > range_m[k] or (range_m[order[at - 1]] == range_m[k] and order[at - 1] > k)
        ):
            order[at] = order[at - 1]
            at -= 1
        order[at] = k


@inner(error_model="numpy")
def _slant(range_m, cosine, step_rad):
    """How far along the beam neighbouring rays hit a surface of such a slant."""
    slant_m = range_m * (math.sqrt(max(1 - cosine * cosine, 0.0)) / cosine) * step_rad
    return slant_m if slant_m < math.inf else 0.0


@inner()
def _begin(echoes, c):
    """Let echo c be empty."""
    for k in range(5):
        echoes[k, c] = 0.0
    echoes[OWNER, c] = NOTHING


@inner()
def _add(echoes, c, range_m, power, shine, thing):
    """Have a ray be a part of echo c."""
    echoes[TOTAL, c] += power
    echoes[MEAN, c] += power * range_m
    echoes[SHINE, c] += shine
    if power > echoes[BEST, c]:
        echoes[BEST, c], echoes[OWNER, c] = power, thing


@inner(error_model="numpy")
def _pick(echoes, found, least, out_m, out_byte, out_object):
    """Write the candidates (6,), as `Echoes` has them."""
    strongest, second, last, first, seen = 0, 0, 0, 0, 0
    for c in range(found):
        total = echoes[TOTAL, c]
        if total > 0 and total >= least:
            first, last = (c if seen == 0 else first), c
            if seen == 0 or total > echoes[TOTAL, strongest]:
                strongest, second = c, (c if seen == 0 else strongest)
            elif seen == 1 or total > echoes[TOTAL, second]:
                second = c
            seen += 1
    with_last, with_first = (second if strongest == last else strongest), (second if strongest == first else strongest)
    which = (strongest, with_last, last, first, with_first, second)
    range_m, byte, thing, known = math.inf, np.uint8(0), np.int32(NOTHING), -1
    for i in range(6):
        c = which[i]
        if c != known:
            range_m, known = echoes[MEAN, c] / echoes[TOTAL, c] if seen else math.inf, c
            byte = np.uint8(min(max(np.rint(echoes[SHINE, c]), 0.0), 255.0))
            thing = np.int32(echoes[OWNER, c])
        out_m[i], out_byte[i], out_object[i] = range_m, byte, thing


@inner(error_model="numpy")
def _merge(hits, laser, weights, limits, drops, fade, out, orders, echoes):
    """As `merged`, in working memory for the orders of rays (lasers, K), and for echoes (5, K + 1)."""
    range_m, reflectivity, objects, cosine = hits
    out_m, out_byte, out_object = out
    most_m, step_rad, least = limits
    for n in range(len(range_m)):
        order, found, before = orders[laser[n]], 0, -1
        _sort(range_m[n], order)
        _begin(echoes, 0)
        nearest_m = range_m[n, order[0]]
        if len(drops) and drops[n, 0] < (nearest_m if nearest_m <= most_m else math.inf):
            far_m, albedo = drops[n, 0], drops[n, 1]
            power = max(albedo * fade[n, len(order)] / (far_m * far_m), FAINTEST)
            _add(echoes, 0, far_m, power, 100 * albedo, NOTHING)
            found = 1
        for i in range(len(order)):
            k = order[i]
            far_m, steep, byte = range_m[n, k], cosine[n, k], reflectivity[n, k]
            if not far_m <= most_m:
                break
            apart = found == 0
            if found:
                apart_m = far_m - (range_m[n, before] if before >= 0 else drops[n, 0])
                apart = not apart_m <= SEPARATION_M
                if apart and before >= 0 and objects[n, k] == objects[n, before]:
                    slack_m = _slant(range_m[n, before], cosine[n, before], step_rad)
                    slack_m = max(_slant(far_m, steep, step_rad), slack_m)
                    apart = not apart_m <= SEPARATION_M + slack_m
            if apart:
                _begin(echoes, found)
                found += 1
            light = weights[k] * (ALBEDO[byte] if byte > DIFFUSE_MAX else ALBEDO[byte] * steep)
            if len(fade):
                light *= fade[n, k]
            power = max(light / (far_m * far_m), FAINTEST)
            _add(echoes, found - 1, far_m, power, weights[k] * float(byte), objects[n, k])
            before = k
        _pick(echoes, found, least, out_m[n], out_byte[n], out_object[n])


@njit(cache=True, nogil=True, error_model="numpy")
def merged(hits, laser, weights, limits, drops, fade, out):
    """Write the candidates (N, 6) of N beams of K rays: ranges, reflectivities and objects.

    Hits (N, K) are ranges, reflectivities, objects and cosines; limits are the greatest range, the angle between rays
    and the least power. In bad weather drops (N, 2) are range and albedo of what the weather echoes, and `fade`
    (N, K + 1) is what is left of the light; else both are empty. Rays are put in the order of range, beginning with
    that of the beam that the laser (N,) fired before. Neighbours merge into an echo, on one object also if its slant
    explains the distance between them: a surface hit at a grazing angle is one echo, though its few rays are far apart.
    """
    width, lasers = len(weights), 0
    for n in range(len(laser)):
        lasers = max(lasers, laser[n] + 1)
    orders, echoes = np.empty((lasers, width), np.int64), np.empty((5, width + 1))
    orders[:] = np.arange(width)
    _merge(hits, laser, weights, limits, drops, fade, out, orders, echoes)

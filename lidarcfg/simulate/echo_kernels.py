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
NO_RAY = np.uint64(99)
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
def _end(echoes, c, total, mean, shine, best, owner):
    """Write echo c."""
    echoes[TOTAL, c], echoes[MEAN, c], echoes[SHINE, c], echoes[BEST, c], echoes[OWNER, c] = (
        total, mean, shine, best, owner,
    )  # fmt: skip


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
        order, found, before, before_m = orders[laser[n]], 0, NO_RAY, 0.0
        total, mean, shine, best, owner = 0.0, 0.0, 0.0, 0.0, NOTHING
        ranges, bytes_, things, steeps = range_m[n], reflectivity[n], objects[n], cosine[n]
        _sort(ranges, order)
        nearest_m = ranges[order[0]]
        if len(drops) and drops[n, 0] < (nearest_m if nearest_m <= most_m else math.inf):
            before_m, albedo = drops[n, 0], drops[n, 1]
            total = max(albedo * fade[n, len(order)] / (before_m * before_m), FAINTEST)
            mean, shine, best, found = total * before_m, 100 * albedo, total, 1
        for i in range(len(order)):
            k = order[i]
            far_m, steep, byte, thing = ranges[k], steeps[k], bytes_[k], things[k]
            if not far_m <= most_m:
                break
            apart = found == 0
            if found:
                apart_m = far_m - before_m
                apart = not apart_m <= SEPARATION_M
                if apart and before != NO_RAY and thing == things[before]:
                    slack_m = _slant(before_m, steeps[before], step_rad)
                    slack_m = max(_slant(far_m, steep, step_rad), slack_m)
                    apart = not apart_m <= SEPARATION_M + slack_m
            if apart:
                if found:
                    _end(echoes, found - 1, total, mean, shine, best, owner)
                total, mean, shine, best, owner = 0.0, 0.0, 0.0, 0.0, NOTHING
                found += 1
            light = weights[k] * (ALBEDO[byte] if byte > DIFFUSE_MAX else ALBEDO[byte] * steep)
            if len(fade):
                light *= fade[n, k]
            power = max(light / (far_m * far_m), FAINTEST)
            total, mean, shine = total + power, mean + power * far_m, shine + weights[k] * float(byte)
            if power > best:
                best, owner = power, thing
            before, before_m = k, far_m
        _end(echoes, max(found - 1, 0), total, mean, shine, best, owner)
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
    orders, echoes = np.empty((lasers, width), np.uint64), np.empty((5, width + 1))
    for k in range(width):
        orders[:, k] = k
    _merge(hits, laser, weights, limits, drops, fade, out, orders, echoes)

"""The echoes of wide beams: what their rays hit, merged where the sensor cannot tell it apart."""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
import math

import numpy as np

from lidarcfg.jit import inner, njit

DIFFUSE_MAX = 100  # a reflectivity beyond is a retro-reflector's
SEPARATION_M = 1.0  # closer echoes merge (VLP-16 and VLS-128 manuals: dual returns are at least 1 m apart)
FAINTEST = 1e-30  # power of an echo from a black or edge-on surface: detected unless there is a detection limit
NOTHING = -1  # an object
RANGE, POWER, BYTE, SLANT, OBJECT = range(5)  # rows of the rays of a beam
TOTAL, MEAN, SHINE, BEST, OWNER = range(5)  # rows of its echoes


@inner(error_model="numpy")
def _insert(rays, count, range_m, power, byte, slant_m, thing):
    """Put a ray in the order of range; of equal ones, behind."""
    at = count
    while at > 0 and rays[RANGE, at - 1] > range_m:
        for k in range(5):
            rays[k, at] = rays[k, at - 1]
        at -= 1
    rays[RANGE, at], rays[POWER, at], rays[BYTE, at] = range_m, power, byte
    rays[SLANT, at], rays[OBJECT, at] = slant_m, thing


@inner(error_model="numpy")
def _cluster(rays, count, echoes):
    """Merge the rays into echoes; how many there are.

    Neighbours on one object also merge if its slant explains the distance between them: a surface hit at a grazing
    angle is one echo, even though its few rays are far apart.
    """
    for k in range(5):
        for c in range(len(rays[0])):
            echoes[k, c] = 0.0
    echoes[OWNER, 0] = NOTHING
    found = 0
    for i in range(count):
        range_m, power = rays[RANGE, i], rays[POWER, i]
        slack_m = 0.0
        if i and rays[OBJECT, i] == rays[OBJECT, i - 1]:
            slack_m = max(rays[SLANT, i], rays[SLANT, i - 1])
        if i == 0 or not range_m - rays[RANGE, i - 1] <= SEPARATION_M + slack_m:
            echoes[OWNER, found] = NOTHING
            found += 1
        c = found - 1
        echoes[TOTAL, c] += power
        echoes[MEAN, c] += power * range_m
        echoes[SHINE, c] += rays[BYTE, i]
        if power > echoes[BEST, c]:
            echoes[BEST, c], echoes[OWNER, c] = power, rays[OBJECT, i]
    return found


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
    for i in range(6):
        c = which[i]
        out_m[i] = echoes[MEAN, c] / echoes[TOTAL, c] if seen else math.inf
        out_byte[i] = np.uint8(min(max(np.rint(echoes[SHINE, c]), 0.0), 255.0))
        out_object[i] = np.int32(echoes[OWNER, c])


@njit(cache=True, nogil=True, error_model="numpy")
def merged(hits, weights, limits, drops, fade, out):
    """Write the candidates (N, 6) of N beams of K rays: ranges, reflectivities and objects.

    Hits (N, K) are ranges, reflectivities, objects and cosines; limits are the greatest range, the angle between rays
    and the least power. In bad weather drops (N, 2) are range and albedo of what the weather echoes, and `fade`
    (N, K + 1) is what is left of the light; else both are empty.
    """
    range_m, reflectivity, objects, cosine = hits
    out_m, out_byte, out_object = out
    most_m, step_rad, least = limits
    width = range_m.shape[1]
    rays, echoes = np.empty((5, width + 1)), np.empty((5, width + 1))
    for n in range(len(range_m)):
        count, nearest_m = 0, math.inf
        for k in range(width):
            far_m, steep = range_m[n, k], cosine[n, k]
            if not far_m <= most_m:
                continue
            nearest_m = min(nearest_m, far_m)
            albedo = reflectivity[n, k] / 100
            light = weights[k] * (albedo if reflectivity[n, k] > DIFFUSE_MAX else albedo * steep)
            if len(fade):
                light *= fade[n, k]
            power = max(light / (far_m * far_m), FAINTEST)
            slant_m = far_m * (math.sqrt(max(1 - steep * steep, 0.0)) / steep) * step_rad
            slant_m = slant_m if slant_m < math.inf else 0.0
            _insert(rays, count, far_m, power, weights[k] * float(reflectivity[n, k]), slant_m, float(objects[n, k]))
            count += 1
        if len(drops) and drops[n, 0] < nearest_m:
            far_m, albedo = drops[n, 0], drops[n, 1]
            power = max(albedo * fade[n, width] / (far_m * far_m), FAINTEST)
            _insert(rays, count, far_m, power, 100 * albedo, 0.0, float(NOTHING))
            count += 1
        found = _cluster(rays, count, echoes)
        _pick(echoes, found, least, out_m[n], out_byte[n], out_object[n])

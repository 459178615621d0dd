"""The echoes of one wide beam in plain loops, by the words of docs/realism.md, "Several echoes"."""

import math

APART_M = 1.0


def brightness(hit, weight, left):
    """The power that comes back of a hit: its share of the light, by the LiDAR equation."""
    range_m, reflectivity, _, cosine = hit
    albedo = reflectivity / 100 * (cosine if reflectivity <= 100 else 1)
    return max(weight * albedo * left / range_m**2, 1e-30)


def slant_m(hit, step_rad):
    """How far neighbouring rays are apart on a slanted surface."""
    return hit[0] * math.tan(math.acos(min(hit[3], 1))) * step_rad if hit[3] > 0 else 0.0


def echoes(hits, weights, most_m, step_rad, least, drop=None, left=None):
    """[(range, reflectivity, object)] by name of the candidate; None: nothing. Hits: range, reflectivity, object, cosine."""
    rays = [
        (hit[0], brightness(hit, weight, left[k] if left else 1), weight * hit[1], hit[2], slant_m(hit, step_rad))
        for k, (hit, weight) in enumerate(zip(hits, weights, strict=True))
        if hit[0] <= most_m
    ]
    if drop and all(drop[0] < ray[0] for ray in rays):
        rays.append((drop[0], max(drop[1] * left[-1] / drop[0] ** 2, 1e-30), 100 * drop[1], -1, 0.0))
    groups = []
    for ray in sorted(rays, key=lambda ray: ray[0]):
        before = groups[-1][-1] if groups else None
        apart_m = APART_M + (max(ray[4], before[4]) if before and before[3] == ray[3] else 0)
        if before and ray[0] - before[0] <= apart_m:
            groups[-1].append(ray)
        else:
            groups.append([ray])
    found = []
    for group in groups:
        power = sum(ray[1] for ray in group)
        mean_m = sum(ray[0] * ray[1] for ray in group) / power
        byte = min(max(round(sum(ray[2] for ray in group)), 0), 255)
        brightest = max(group, key=lambda ray: ray[1])
        if power >= least:
            found.append((mean_m, byte, brightest[3], power))
    if not found:
        return [None] * 6
    ranked = sorted(found, key=lambda echo: -echo[3])
    strongest = ranked[0]
    second = ranked[min(1, len(ranked) - 1)]
    last = found[-1]
    first = found[0]
    with_last = second if strongest is last else strongest
    with_first = second if strongest is first else strongest
    return [echo[:3] for echo in (strongest, with_last, last, first, with_first, second)]

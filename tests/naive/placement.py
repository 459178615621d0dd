"""Plain-loop twins of the placement kernels, written from the paper's text, and the released program's rule.

Below them those of casting: triangles made ready, and what of them beams can meet.
"""

import itertools
import math

OUTSIDE = -1


def matrix(rpy):
    """R = Rz(yaw) Ry(pitch) Rx(roll) by multiplying the three elementary rotations."""
    (cr, sr), (cp, sp), (cy, sy) = [(math.cos(a), math.sin(a)) for a in rpy]
    rx = [[1, 0, 0], [0, cr, -sr], [0, sr, cr]]
    ry = [[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]
    rz = [[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]
    return times(rz, times(ry, rx))


def times(a, b):
    """The product of two 3×3 matrices."""
    return [[sum(a[i][k] * b[k][j] for k in range(3)) for j in range(3)] for i in range(3)]


def local(point, position, rpy):
    """X_l = Rᵀ (X_w − t) (paper, eq. 5)."""
    r = matrix(rpy)
    d = [point[i] - position[i] for i in range(3)]
    return [sum(r[k][i] * d[k] for k in range(3)) for i in range(3)]


def digit(point, position, rpy, elevation_deg):
    """How many beams k have z_l >= tan θ_k sqrt(x_l² + y_l²) (paper, eq. 6 to 8)."""
    x, y, z = local(point, position, rpy)
    flat = math.hypot(x, y)
    return sum(z >= math.tan(math.radians(theta)) * flat for theta in elevation_deg)


def centres(low, high, edge):
    """The cuboids' centres along one axis."""
    count = round((high - low) / edge)
    return [low + (i + 0.5) * (high - low) / count for i in range(count)]


def base_n(digits, bases):
    """d_1 d_2 … d_n as one whole number."""
    number = 0
    for d, base in zip(digits, bases, strict=True):
        number = number * base + d
    return number


def breadth_first(signature, included):
    """Components by breadth-first search over shared faces; nested lists in, nested lists of labels out."""
    nx = len(signature)
    ny = len(signature[0])
    nz = len(signature[0][0])
    label = [[[OUTSIDE] * nz for _ in range(ny)] for _ in range(nx)]
    count = 0
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if not included[i][j][k] or label[i][j][k] != OUTSIDE:
                    continue
                label[i][j][k] = count
                queue = [(i, j, k)]
                while queue:
                    a, b, c = queue.pop(0)
                    for u, v, w in neighbours(a, b, c, nx, ny, nz):
                        if included[u][v][w] and label[u][v][w] == OUTSIDE and signature[u][v][w] == signature[i][j][k]:
                            label[u][v][w] = count
                            queue.append((u, v, w))
                count += 1
    return label, count


def neighbours(i, j, k, nx, ny, nz):
    """The up to six cuboids that share a face."""
    for di, dj, dk in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)):
        if 0 <= i + di < nx and 0 <= j + dj < ny and 0 <= k + dk < nz:
            yield i + di, j + dj, k + dk


def vsr(cells, edges):
    """Volume to surface of a set of cuboids (i, j, k): every face without a neighbour in the set counts."""
    ex, ey, ez = edges
    area = [ey * ez, ex * ez, ex * ey]
    surface = 0.0
    for cell in cells:
        for axis in range(3):
            for step in (-1, 1):
                other = list(cell)
                other[axis] += step
                if tuple(other) not in cells:
                    surface += area[axis]
    return len(cells) * ex * ey * ez / surface


def detection(label, size, threshold, on_ground):
    """(detected, places) of a box of whole cuboids moved over the grid."""
    nx = len(label)
    ny = len(label[0])
    nz = len(label[0][0])
    detected = places = 0
    for i in range(nx - size[0] + 1):
        for j in range(ny - size[1] + 1):
            for k in range(1 if on_ground else nz - size[2] + 1):
                touched = {
                    label[a][b][c]
                    for a in range(i, i + size[0])
                    for b in range(j, j + size[1])
                    for c in range(k, k + size[2])
                }
                if OUTSIDE not in touched:
                    places += 1
                    detected += len(touched) > threshold
    return detected, places


def inscribed_radius(cells, edges, shape):
    """Largest sphere inside a set of cuboids, over centres on the lattice of half cuboids, by brute force."""
    nx, ny, nz = shape
    outside = [
        (i, j, k)
        for i in range(-1, nx + 1)
        for j in range(-1, ny + 1)
        for k in range(-1, nz + 1)
        if (i, j, k) not in cells
    ]
    best = 0.0
    for a in range(2 * nx + 1):
        for b in range(2 * ny + 1):
            for c in range(2 * nz + 1):
                node = (a / 2, b / 2, c / 2)
                nearest = math.inf
                for cell in outside:
                    gap = [max(cell[n] - node[n], node[n] - cell[n] - 1, 0) * edges[n] for n in range(3)]
                    nearest = min(nearest, math.hypot(*gap))
                best = max(best, nearest)
    return best


def released_max_vsr(roi, cuboid, exclude, poses, elevation_deg):
    """What the authors' released program computes, which is not the paper's text (see docs/evidence/paper.md).

    Digits are added up instead of written as a base-n number; no connected components; the excluded box runs
    from int(min / edge) to int(max / edge), both included; a centre on a cone belongs to the gap below.
    """
    count = [round(roi[n] / cuboid[n]) for n in range(3)]
    first = [int(exclude[0][n] / cuboid[n]) for n in range(3)]
    last = [int(exclude[1][n] / cuboid[n]) for n in range(3)]
    tangent = [math.tan(math.radians(theta)) for theta in elevation_deg]
    rotations = [(pose["position_m"], matrix(pose["rpy_rad"])) for pose in poses]
    label = {}
    for i in range(count[0]):
        for j in range(count[1]):
            for k in range(count[2]):
                cell = (i, j, k)
                if all(first[n] <= cell[n] <= last[n] for n in range(3)):
                    continue
                point = [(cell[n] + 0.5) * cuboid[n] for n in range(3)]
                total = 0
                for m, (t, r) in enumerate(rotations):
                    d = [point[n] - t[n] for n in range(3)]
                    x, y, z = (sum(r[n][axis] * d[n] for n in range(3)) for axis in range(3))
                    flat = math.sqrt(x * x + y * y)
                    total += m * (len(tangent) + 1) + sum(z > slope * flat for slope in tangent)
                label[cell] = total
    area = [cuboid[1] * cuboid[2], cuboid[0] * cuboid[2], cuboid[0] * cuboid[1]]
    volume = {}
    surface = {}
    for (i, j, k), mine in label.items():
        volume[mine] = volume.get(mine, 0.0) + cuboid[0] * cuboid[1] * cuboid[2]
        for axis, (di, dj, dk) in enumerate(((1, 0, 0), (0, 1, 0), (0, 0, 1))):
            for step in (-1, 1):
                if label.get((i + step * di, j + step * dj, k + step * dk)) != mine:
                    surface[mine] = surface.get(mine, 0.0) + area[axis]
    return max(volume[mine] / surface[mine] for mine in volume)


def crossings(origin, direction, low, high, position, axis, elevation_deg, steps=300):
    """Where the line origin + s · direction crosses one cone: (s, |n·direction|) by small steps and bisection."""

    def side(s):
        d = [origin[i] + s * direction[i] - position[i] for i in range(3)]
        return sum(d[i] * axis[i] for i in range(3)) - math.sin(math.radians(elevation_deg)) * math.hypot(*d)

    found = []
    ends = [low + (high - low) * i / steps for i in range(steps + 1)]
    for a, b in itertools.pairwise(ends):
        if (side(a) >= 0) == (side(b) >= 0):
            continue
        for _ in range(60):
            middle = (a + b) / 2
            a, b = (middle, b) if (side(middle) >= 0) == (side(a) >= 0) else (a, middle)
        point = [origin[i] + a * direction[i] for i in range(3)]
        gradient = []
        for i in range(3):
            ahead = list(point)
            behind = list(point)
            ahead[i] = point[i] + 1e-6
            behind[i] = point[i] - 1e-6
            values = []
            for p in (ahead, behind):
                d = [p[n] - position[n] for n in range(3)]
                values.append(
                    sum(d[n] * axis[n] for n in range(3)) - math.sin(math.radians(elevation_deg)) * math.hypot(*d)
                )
            gradient.append((values[0] - values[1]) / 2e-6)
        weight = abs(sum(g * e for g, e in zip(gradient, direction, strict=True))) / math.hypot(*gradient)
        found.append((a, weight))
    return found


def cone_crossings(u, v, low, high, position, axis, sines):
    """Where the line (s, u, v), low < s < high, crosses a LiDAR's cones, ascending: (s, |n·e|), e along the line.

    A point is above a beam by axis·d − sine |d|, d from the LiDAR (paper, eq. 6). Along a line that is concave where the
    sine is positive, convex where it is negative: it is zero once at most on each side of its extremum. A line through
    the LiDAR itself crosses all cones there, where they have no normal: |n·e| is 0.
    """

    def offset(s):
        return s - position[0], u - position[1], v - position[2]

    def above(s, sine):
        d = offset(s)
        return math.fsum(d[n] * axis[n] for n in range(3)) - sine * math.hypot(*d)

    def weight(s, sine):
        d = offset(s)
        along = [component / math.hypot(*d) for component in d]  # a cone's normal is across it, towards the axis
        normal = [axis[n] - math.fsum(axis[k] * along[k] for k in range(3)) * along[n] for n in range(3)]
        return abs(normal[0]) / math.hypot(*normal)

    found = []
    for sine in sines:
        if abs(sine) >= 1:
            continue  # closed to its axis
        if abs(sine) < 1e-9:
            sine = 0.0  # a level beam is a plane
        if u == position[1] and v == position[2]:
            found += [(position[0], 0.0)] * (low < position[0] < high)
            continue
        ends = [low, extremum(lambda s, sine=sine: above(s, sine) * (1 if sine > 0 else -1), low, high), high]
        for a, b in itertools.pairwise(ends):
            if (above(a, sine) >= 0) != (above(b, sine) >= 0):
                s = zero(lambda s, sine=sine: above(s, sine), a, b)
                found.append((s, weight(s, sine)))
    return sorted(found)


def extremum(concave, low, high):
    """Where a concave function is greatest, by thirds."""
    for _ in range(200):
        third = (high - low) / 3
        if concave(low + third) < concave(high - third):
            low += third
        else:
            high -= third
    return (low + high) / 2


def zero(function, low, high):
    """Where a function changes its sign, by halves."""
    for _ in range(80):
        half = (low + high) / 2
        low, high = (half, high) if (function(half) >= 0) == (function(low) >= 0) else (low, half)
    return (low + high) / 2


def sweep(label, gap, low, edge, cones, lines=2, within=None, sight=None):
    """What straight lines along the first axis see of subspaces: (volume, pieces, surface, pairs that are one).

    label[i][j][k] is a cuboid's subspace, −1 outside the region; gap[subspace] its beam gap for each of the cones, which
    are (position, axis, sines). Each line stands for a part of the cuboids' faces across it, `lines`² of them to a
    face: they lie on the lattice whose first coordinate is even and whose second goes by golden sections. A piece of a
    line from one crossing or wall to the next has length, two ends, and the gaps of its midpoint. It belongs to the
    subspaces of these gaps in the cuboids that it passes, else in those and their neighbours all around; if they are
    several, they are one, and the first has it. Pieces shorter than 1e-9 of an edge are nobody's.

    within[i][j][k]: what the region would be without bodies that end it; else where labels are. sight[line]: for each
    LiDAR, and last for the bodies, whether the line begins in sight, or outside, and (place, |n·e|) of each change. What
    is out of a LiDAR's sight has the gap −1 for it, and its cones cut nothing there; what is in a body is nobody's.
    """
    nx = len(label)
    ny = len(label[0])
    nz = len(label[0][0])
    count = ny * nz * lines**2
    area = edge[1] * edge[2] / lines**2
    volume = [0.0] * len(gap)
    pieces = [0] * len(gap)
    surface = [0.0] * len(gap)
    pairs = []

    def wall(i):
        return low[0] + i * edge[0]

    def those(gaps, cells):
        there = [label[a][b][c] for a, b, c in sorted(set(cells)) if 0 <= a < nx and 0 <= b < ny and 0 <= c < nz]
        return [one for one in there if one >= 0 and gap[one] == gaps]

    for number in range(count):
        across = ny * (number + 0.5) / count, nz * ((number * (math.sqrt(5) - 1) / 2 + 0.5) % 1.0)
        j = math.floor(across[0])
        k = math.floor(across[1])
        u, v = low[1] + across[0] * edge[1], low[2] + across[1] * edge[2]
        counts = [within[i][j][k] if within else label[i][j][k] >= 0 for i in range(nx)]
        seen = sight[number] if sight else [(True, [])] * (len(cones) + 1)
        for inside, run in itertools.groupby(range(nx), counts.__getitem__):
            cells = list(run)
            if not inside:
                continue
            first, last = wall(cells[0]), wall(cells[-1] + 1)
            cuts = [change for _, changes in seen for change in changes if first < change[0] < last]
            for one, view in zip(cones, seen, strict=False):
                cuts += [cut for cut in cone_crossings(u, v, first, last, *one) if in_sight(view, cut[0])]
            for (here, face), (there, other) in itertools.pairwise([(first, 1.0), *sorted(cuts), (last, 1.0)]):
                middle = (here + there) / 2
                if there - here <= 1e-9 * edge[0] or not in_sight(seen[-1], middle):
                    continue
                views = [in_sight(view, middle) for view in seen]
                gaps = [gap_of((middle, u, v), *one) if view else -1 for one, view in zip(cones, views, strict=False)]
                passed = [i for i in cells if wall(i) < there and wall(i + 1) > here]
                own = those(gaps, [(i, j, k) for i in passed])
                if not own:
                    near = itertools.product((-1, 0, 1), repeat=3)
                    own = those(gaps, [(i + a, j + b, k + c) for a, b, c in near for i in passed])
                if own:
                    volume[own[0]] += (there - here) * area
                    pieces[own[0]] += 1
                    surface[own[0]] += (face + other) * area
                    pairs += itertools.pairwise(own)
    return volume, pieces, surface, pairs


def in_sight(view, place):
    """Whether a place is in sight, of a line that begins so or not, and of its changes."""
    return view[0] != (sum(at < place for at, _ in view[1]) % 2 == 1)


def gap_of(point, position, axis, sines):
    """How many beams a point lies on or above."""
    d = [point[n] - position[n] for n in range(3)]
    return sum(sum(d[n] * axis[n] for n in range(3)) >= sine * math.hypot(*d) for sine in sines)


def wholes(count, pairs):
    """The least number of each one's group, where pairs are in one group: by walking from each least one to all others."""
    beside = {number: set() for number in range(count)}
    for a, b in pairs:
        beside[a].add(b)
        beside[b].add(a)
    least = [None] * count
    for number in range(count):
        waiting = [number] if least[number] is None else []
        while waiting:
            one = waiting.pop()
            if least[one] is None:
                least[one] = number
                waiting += beside[one]
    return least

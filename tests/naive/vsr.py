"""Plain-loop twins of the kernels of VSR, written from the paper's text, and the released program's rule.

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
    others = outside(cells, shape)
    nodes = itertools.product(*[[half / 2 for half in range(2 * n + 1)] for n in shape])
    return max(distance(node, others, edges) for node in nodes)


def outside(cells, shape):
    """The cuboids of a grid, and one layer around it, that are not in a set."""
    return [cell for cell in itertools.product(*[range(-1, n + 1) for n in shape]) if cell not in cells]


def distance(node, cells, edges):
    """From a point, in cuboids, to the nearest of some cuboids."""
    nearest = math.inf
    for cell in cells:
        gap = [max(cell[n] - node[n], node[n] - cell[n] - 1, 0) * edges[n] for n in range(3)]
        nearest = min(nearest, math.hypot(*gap))
    return nearest


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

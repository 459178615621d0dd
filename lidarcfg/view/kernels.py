"""The inner loop of stills: translucent triangles behind and in front of points."""

import numpy as np

from lidarcfg.jit import njit


@njit(cache=True, nogil=True)
def fill(image, depth_m, triangles, colours, alpha, focal_px, near_m):
    """Blend triangles (T, 3, 3), far to near, into image (H, W, 3) where they are nearer than depth_m (H, W).

    Corners are right, up and ahead of the camera in metres; colours (T, 3) as the image's, alpha (T,) 0 to 1. What is
    nearer than `near_m` is clipped. Returns how many pixels were blended.
    """
    height, width = depth_m.shape
    corner = np.empty((4, 3))
    cut = np.empty((4, 3))
    blended = 0
    for t in range(len(triangles)):
        n = 0
        for i in range(3):  # clip at the near plane: three or four corners remain
            a = triangles[t, i]
            b = triangles[t, (i + 1) % 3]
            if a[2] >= near_m:
                cut[n] = a
                n += 1
            if (a[2] >= near_m) != (b[2] >= near_m):
                cut[n] = a + (near_m - a[2]) / (b[2] - a[2]) * (b - a)
                n += 1
        for i in range(n):  # column, row and 1 / depth, which is linear in them
            corner[i, 0] = width / 2 + focal_px * cut[i, 0] / cut[i, 2]
            corner[i, 1] = height / 2 - focal_px * cut[i, 1] / cut[i, 2]
            corner[i, 2] = 1 / cut[i, 2]
        for k in range(1, n - 1):
            p = corner[0]
            q = corner[k]
            r = corner[k + 1]
            area = (q[0] - p[0]) * (r[1] - p[1]) - (r[0] - p[0]) * (q[1] - p[1])
            if area == 0:
                continue
            left = max(int(np.ceil(max(min(p[0], q[0], r[0]), -1.0) - 0.5)), 0)
            right = min(int(np.floor(min(max(p[0], q[0], r[0]), width + 1.0) - 0.5)), width - 1)
            top = max(int(np.ceil(max(min(p[1], q[1], r[1]), -1.0) - 0.5)), 0)
            bottom = min(int(np.floor(min(max(p[1], q[1], r[1]), height + 1.0) - 0.5)), height - 1)
            for row in range(top, bottom + 1):
                for column in range(left, right + 1):
                    x = column + 0.5
                    y = row + 0.5
                    u = ((x - p[0]) * (r[1] - p[1]) - (r[0] - p[0]) * (y - p[1])) / area
                    v = ((q[0] - p[0]) * (y - p[1]) - (x - p[0]) * (q[1] - p[1])) / area
                    if u < 0 or v < 0 or u + v > 1:
                        continue
                    if (p[2] + u * (q[2] - p[2]) + v * (r[2] - p[2])) * depth_m[row, column] > 1:
                        for c in range(3):
                            image[row, column, c] += alpha[t] * (colours[t, c] - image[row, column, c])
                        blended += 1
    return blended

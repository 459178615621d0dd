"""Vectors of three numbers, of floats or of whole numbers of any length, as plain lists."""


def minus(p, q):
    return [a - b for a, b in zip(p, q, strict=True)]


def dot(p, q):
    return sum(a * b for a, b in zip(p, q, strict=True))


def cross(p, q):
    return [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]

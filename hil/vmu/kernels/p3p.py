"""Perspective-three-point problem (P3P): the pose from three points in one camera, up to four solutions.

Persson and Nordberg, "Lambda Twist: An Accurate Fast Robust Perspective Three Point (P3P) Solver", ECCV 2018.
If noise makes a double root complex (three points seen head-on), its real part is used: the solution is only a
start for a refinement on more points.
"""

from __future__ import annotations

import math

from hil.core.jit import kernel


@kernel
def cubic_root(b, c, d):
    """Return a real root of x^3 + b x^2 + c x + d, by Newton's method from beyond the turning points."""
    # start beyond the outer turning point, or at the point of inflexion if there is no turning point
    start = -b / 3.0
    under = b * b - 3.0 * c
    if under > 0.0:
        root = math.sqrt(under)
        left = (-b - root) / 3.0
        value = ((left + b) * left + c) * left + d
        start = left - math.sqrt(abs(value) / root) if value > 0.0 else (-b + root) / 3.0
        if value <= 0.0:
            right = start
            value = ((right + b) * right + c) * right + d
            start = right + math.sqrt(abs(value) / root)
    elif abs(((start + b) * start + c) * start + d) > 0.0:
        value = ((start + b) * start + c) * start + d
        start -= math.copysign(abs(value) ** (1.0 / 3.0), value)
    x = start
    for _ in range(60):
        value = ((x + b) * x + c) * x + d
        slope = (3.0 * x + 2.0 * b) * x + c
        if slope == 0.0:
            break
        step = value / slope
        x -= step
        if abs(step) < 1e-15 * (abs(x) + 1e-3):
            break
    return x


@kernel
def null_eigen(a, vectors, values):
    """Write the two eigenvectors (columns) of the non-zero eigenvalues of the symmetric, singular ``a`` (3, 3).

    values: (2,), the larger in size first.
    """
    trace = a[0, 0] + a[1, 1] + a[2, 2]
    minors = (a[0, 0] * a[1, 1] + a[0, 0] * a[2, 2] + a[1, 1] * a[2, 2] - a[0, 1] * a[0, 1] - a[0, 2] * a[0, 2]) - a[
        1, 2
    ] * a[1, 2]
    root = math.sqrt(max(0.25 * trace * trace - minors, 0.0))
    first = 0.5 * trace + math.copysign(root, trace)
    values[0] = first
    values[1] = minors / first if first != 0.0 else 0.0
    for k in range(2):
        e = values[k]
        # the longest cross product of two rows of a - e I spans the eigenvector
        best = -1.0
        for m in range(3):
            i, j = (m + 1) % 3, (m + 2) % 3
            i0 = a[i, 0] - (e if i == 0 else 0.0)
            i1 = a[i, 1] - (e if i == 1 else 0.0)
            i2 = a[i, 2] - (e if i == 2 else 0.0)
            j0 = a[j, 0] - (e if j == 0 else 0.0)
            j1 = a[j, 1] - (e if j == 1 else 0.0)
            j2 = a[j, 2] - (e if j == 2 else 0.0)
            x, y, z = i1 * j2 - i2 * j1, i2 * j0 - i0 * j2, i0 * j1 - i1 * j0
            size = x * x + y * y + z * z
            if size > best:
                best = size
                scale = 1.0 / math.sqrt(size) if size > 0.0 else 0.0
                vectors[0, k] = x * scale
                vectors[1, k] = y * scale
                vectors[2, k] = z * scale


@kernel
def polish(b12, b13, b23, a12, a13, a23, lengths):
    """Refine the three ray lengths in place to match the distances between the points (Newton's method)."""
    l1, l2, l3 = lengths[0], lengths[1], lengths[2]
    for _ in range(3):
        r1 = l1 * l1 + l2 * l2 + b12 * l1 * l2 - a12
        r2 = l1 * l1 + l3 * l3 + b13 * l1 * l3 - a13
        r3 = l2 * l2 + l3 * l3 + b23 * l2 * l3 - a23
        size = abs(r1) + abs(r2) + abs(r3)
        if size < 1e-12:
            break
        d11, d12 = 2.0 * l1 + b12 * l2, 2.0 * l2 + b12 * l1
        d21, d23 = 2.0 * l1 + b13 * l3, 2.0 * l3 + b13 * l1
        d32, d33 = 2.0 * l2 + b23 * l3, 2.0 * l3 + b23 * l2
        det = -d11 * d23 * d32 - d12 * d21 * d33
        if det == 0.0:
            break
        m1 = l1 - (-d23 * d32 * r1 - d12 * d33 * r2 + d12 * d23 * r3) / det
        m2 = l2 - (-d21 * d33 * r1 + d11 * d33 * r2 - d11 * d23 * r3) / det
        m3 = l3 - (d21 * d32 * r1 - d11 * d32 * r2 - d12 * d21 * r3) / det
        new = (
            abs(m1 * m1 + m2 * m2 + b12 * m1 * m2 - a12)
            + abs(m1 * m1 + m3 * m3 + b13 * m1 * m3 - a13)
            + abs(m2 * m2 + m3 * m3 + b23 * m2 * m3 - a23)
        )
        if not new < size:
            break
        l1, l2, l3 = m1, m2, m3
    lengths[0], lengths[1], lengths[2] = l1, l2, l3


@kernel
def ray_lengths(y1, y2, y3, a12, a13, a23, a, vectors, values, out):
    """Write the distances of the three points along the unit rays y1, y2, y3 to out (4, 3); return how many solutions.

    a12, a13, a23: squares of the distances between the points. a (3, 3), vectors (3, 2) and values (2,): scratch.
    """
    c12 = y1[0] * y2[0] + y1[1] * y2[1] + y1[2] * y2[2]
    c13 = y1[0] * y3[0] + y1[1] * y3[1] + y1[2] * y3[2]
    c23 = y2[0] * y3[0] + y2[1] * y3[1] + y2[2] * y3[2]
    b12, b13, b23 = -2.0 * c12, -2.0 * c13, -2.0 * c23
    blob = c12 * c23 * c13 - 1.0
    s12, s13, s23 = 1.0 - c12 * c12, 1.0 - c13 * c13, 1.0 - c23 * c23
    p3 = a13 * (a23 * s13 - a13 * s23)
    p2 = 2.0 * blob * a23 * a13 + a13 * (2.0 * a12 + a13) * s23 + a23 * (a23 - a12) * s13
    p1 = a23 * (a13 - a23) * s12 - a12 * a12 * s23 - 2.0 * a12 * (blob * a23 + a13 * s23)
    p0 = a12 * (a12 * s23 - a23 * s12)
    if abs(p3) >= abs(p0):
        g = cubic_root(p2 / p3, p1 / p3, p0 / p3)
    elif p0 != 0.0:
        inverse = cubic_root(p1 / p0, p2 / p0, p3 / p0)
        if inverse == 0.0:
            return 0
        g = 1.0 / inverse
    else:
        return 0
    a[0, 0] = a23 * (1.0 - g)
    a[0, 1] = a[1, 0] = 0.5 * a23 * b12
    a[0, 2] = a[2, 0] = -0.5 * a23 * b13 * g
    a[1, 1] = a23 - a12 + a13 * g
    a[1, 2] = a[2, 1] = 0.5 * b23 * (a13 * g - a12)
    a[2, 2] = g * (a13 - a23) - a12
    null_eigen(a, vectors, values)
    ratio = math.sqrt(max(-values[1] / values[0], 0.0)) if values[0] != 0.0 else 0.0
    count = 0
    for sign in range(2):
        s = ratio if sign == 0 else -ratio
        below = s * vectors[0, 1] - vectors[0, 0]
        if below == 0.0:
            continue
        w0 = (vectors[1, 0] - s * vectors[1, 1]) / below
        w1 = (vectors[2, 0] - s * vectors[2, 1]) / below
        top = (a13 - a12) * w1 * w1 - a12 * b13 * w1 - a12
        if top == 0.0:
            continue
        b = (a13 * b12 * w1 - a12 * b13 * w0 - 2.0 * w0 * w1 * (a12 - a13)) / top
        c = ((a13 - a12) * w0 * w0 + a13 * b12 * w0 + a13) / top
        under = 0.25 * b * b - c
        if under < -0.01 * (1.0 + 0.25 * b * b):
            continue
        root = math.sqrt(max(under, 0.0))
        for k in range(2):
            tau = -0.5 * b + (root if k == 0 else -root)
            if k == 1 and root == 0.0:
                break
            if not tau > 0.0:
                continue
            square = tau * (b23 + tau) + 1.0
            if not square > 0.0:
                continue
            l2 = math.sqrt(a23 / square)
            l3 = tau * l2
            l1 = w0 * l2 + w1 * l3
            if l1 > 0.0:
                out[count, 0], out[count, 1], out[count, 2] = l1, l2, l3
                polish(b12, b13, b23, a12, a13, a23, out[count])
                count += 1
    return count


@kernel
def axes_of_three(p1, p2, p3, out):
    """Write the axes of the triangle, the columns of out (3, 3): along p2 - p1, in the plane, normal to it."""
    x0, x1, x2 = p2[0] - p1[0], p2[1] - p1[1], p2[2] - p1[2]
    size = 1.0 / math.sqrt(x0 * x0 + x1 * x1 + x2 * x2)
    x0, x1, x2 = x0 * size, x1 * size, x2 * size
    d0, d1, d2 = p3[0] - p1[0], p3[1] - p1[1], p3[2] - p1[2]
    z0, z1, z2 = x1 * d2 - x2 * d1, x2 * d0 - x0 * d2, x0 * d1 - x1 * d0
    size = 1.0 / math.sqrt(z0 * z0 + z1 * z1 + z2 * z2)
    z0, z1, z2 = z0 * size, z1 * size, z2 * size
    out[0, 0], out[1, 0], out[2, 0] = x0, x1, x2
    out[0, 1], out[1, 1], out[2, 1] = z1 * x2 - z2 * x1, z2 * x0 - z0 * x2, z0 * x1 - z1 * x0
    out[0, 2], out[1, 2], out[2, 2] = z0, z1, z2

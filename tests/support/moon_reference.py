"""An independent lunar field for the tests: other recursions than the product's, in plain Python."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
from scipy.special import lpmv

GM, RADIUS_M = 4902.801056e9, 1738.0e3
DEGREE = 8
SHIPPED = Path(__file__).resolve().parents[2] / "configs" / "bodies" / "lp165p_8.tab"


def coefficients() -> tuple[np.ndarray, np.ndarray]:
    """Return C and S, (9, 9), indexed [n, m], fully normalised, as the shipped file has them."""
    c, s = np.zeros((DEGREE + 1, DEGREE + 1)), np.zeros((DEGREE + 1, DEGREE + 1))
    with SHIPPED.open(encoding="ascii") as file:
        for row in list(csv.reader(file))[1:]:
            c[int(row[0]), int(row[1])], s[int(row[0]), int(row[1])] = float(row[2]), float(row[3])
    return c, s


def norm(n: int, m: int) -> float:
    """Return the factor from fully normalised to plain coefficients."""
    return math.sqrt((1 if m == 0 else 2) * (2 * n + 1) * math.factorial(n - m) / math.factorial(n + m))


_C, _S = coefficients()
_FACTOR = np.array([[norm(n, m) if m <= n else 0.0 for m in range(DEGREE + 1)] for n in range(DEGREE + 1)])
_PLAIN_C, _PLAIN_S = _C * _FACTOR, _S * _FACTOR


def potential(r: np.ndarray) -> float:
    """Return the potential without the point mass, m^2/s^2, Moon-fixed, by associated Legendre functions."""
    distance = float(np.linalg.norm(r))
    longitude = math.atan2(r[1], r[0])
    total = 0.0
    for n in range(2, DEGREE + 1):
        for m in range(n + 1):
            legendre = (-1) ** m * lpmv(m, n, r[2] / distance)
            wave = _PLAIN_C[n, m] * math.cos(m * longitude) + _PLAIN_S[n, m] * math.sin(m * longitude)
            total += (RADIUS_M / distance) ** n * legendre * wave
    return GM / distance * total


def harmonics(r: np.ndarray) -> np.ndarray:
    """Return the acceleration without the point mass, (3,), m/s^2, Moon-fixed.

    Cunningham's V and W (Montenbruck and Gill, Satellite Orbits, section 3.2.4 and 3.2.5), not normalised.
    """
    x, y, z = (RADIUS_M * value / float(r @ r) for value in r)
    step = RADIUS_M**2 / float(r @ r)
    size = DEGREE + 2
    v, w = np.zeros((size, size)), np.zeros((size, size))
    v[0, 0] = RADIUS_M / float(np.linalg.norm(r))
    for m in range(size):
        if m:
            v[m, m] = (2 * m - 1) * (x * v[m - 1, m - 1] - y * w[m - 1, m - 1])
            w[m, m] = (2 * m - 1) * (x * w[m - 1, m - 1] + y * v[m - 1, m - 1])
        for n in range(m + 1, size):
            for a in (v, w):
                a[n, m] = ((2 * n - 1) * z * a[n - 1, m] - (n + m - 1) * step * a[n - 2, m] * (n > 1)) / (n - m)
    out = np.zeros(3)
    for n in range(2, DEGREE + 1):
        for m in range(n + 1):
            c, s, k = _PLAIN_C[n, m], _PLAIN_S[n, m], n + 1
            if m == 0:
                out += c * np.array([-v[k, 1], -w[k, 1], 0.0])
            else:
                f = (n - m + 2) * (n - m + 1)
                out[0] += 0.5 * (-c * v[k, m + 1] - s * w[k, m + 1] + f * (c * v[k, m - 1] + s * w[k, m - 1]))
                out[1] += 0.5 * (-c * w[k, m + 1] + s * v[k, m + 1] + f * (-c * w[k, m - 1] + s * v[k, m - 1]))
            out[2] += (n - m + 1) * (-c * v[k, m] - s * w[k, m])
    return GM / RADIUS_M**2 * out


def gravity(r: np.ndarray, angle: float) -> np.ndarray:
    """Return the whole acceleration, (3,), m/s^2, inertial, with the Moon turned by ``angle``, rad."""
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(-GM * r / np.linalg.norm(r) ** 3 + turn.T @ harmonics(turn @ r))

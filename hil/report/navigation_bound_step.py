"""One pose of the bound of the navigation errors."""

from __future__ import annotations

from hil.core.jit import kernel
from hil.maths import kalman, stack


@kernel
def information_into(covariances, bench_variance, out):
    """Write the diagonals of the inverses of ``covariances`` (n, 3, 3) less the variance of the bench to out (n, 3)."""
    own, inverse = stack.matrix(3, 3), stack.matrix(3, 3)
    for k in range(covariances.shape[0]):
        for i in range(3):
            for j in range(3):
                own[i, j] = covariances[k, i, j] - (bench_variance if i == j else 0.0)
        kalman.invert_symmetric_3(own, inverse)
        for i in range(3):
            out[k, i] = inverse[i, i]


@kernel
def advance(p, f, q, variance, half_s, sums):
    """Advance ``p`` (2, 3, 3, 3), of each chain and axis, to the next pose, of ``variance`` (2, 3), and fuse it.

    half_s: half the time between the poses, by which the variances at both ends are added to ``sums`` (2, 3).
    """
    for chain in range(2):
        for axis in range(3):
            state = p[chain, axis]
            before = state[0, 0]
            kalman.propagate_covariance(state, f[chain], q[chain])
            sums[chain, axis] += half_s * (before + state[0, 0])
            total = state[0, 0] + variance[chain, axis]
            cross = stack.vector(3)
            for i in range(3):
                cross[i] = state[i, 0]
            for i in range(3):
                for j in range(3):
                    state[i, j] -= cross[i] / total * cross[j]

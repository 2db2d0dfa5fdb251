"""Compiled Kalman filter over a grid of nodes, and the Rauch-Tung-Striebel smoother behind it.

The model is time-invariant (``x' = F x``, process noise Q), each node has up to m scalar
measurements ``z = h x + noise of variance R``, used one after the other; a NaN is none.
Source: Rauch, Tung and Striebel, Maximum likelihood estimates of linear dynamic systems, 1965.
"""

import math

from companion.jit import step
from companion.samples import Rows


@step
def forward(
    F: Rows,
    Q: Rows,
    x: Rows,
    P: Rows,
    h: Rows,
    z: Rows,
    R: Rows,
    gate: float,
    means: Rows,
    covariances: Rows,
    predicted: Rows,
    predicted_p: Rows,
    work: Rows,
) -> None:
    """Filter forward.

    Parameters
    ----------
    F, Q : shape (s, s).
    x, P : shape (s,) and (s, s), the state before the first node; changed.
    h : shape (n, m, s); z, R : shape (n, m).
    gate : an innovation beyond this many standard deviations is used as if its variance were so
        large that it is just at the gate: an outlier has little weight, and none locks it out.
    means, predicted : shape (n, s), written: after and before the measurements of each node.
    covariances, predicted_p : shape (n, s, s), written.
    work : shape (s, s), scratch.
    """
    s = x.shape[0]
    for node in range(z.shape[0]):
        if node > 0:
            _predict(F, Q, x, P, work)
        for i in range(s):
            predicted[node, i] = x[i]
            for j in range(s):
                predicted_p[node, i, j] = P[i, j]
        for k in range(z.shape[1]):
            if not math.isnan(z[node, k]):
                _update(x, P, h[node, k], z[node, k], R[node, k], gate, work)
        for i in range(s):
            means[node, i] = x[i]
            for j in range(s):
                covariances[node, i, j] = P[i, j]


@step
def _predict(F: Rows, Q: Rows, x: Rows, P: Rows, work: Rows) -> None:
    """x = F x, P = F P F' + Q."""
    s = x.shape[0]
    for i in range(s):
        total = 0.0
        for j in range(s):
            total += F[i, j] * x[j]
        work[0, i] = total
    for i in range(s):
        x[i] = work[0, i]
    for i in range(s):
        for j in range(s):
            total = 0.0
            for k in range(s):
                total += F[i, k] * P[k, j]
            work[i, j] = total
    for i in range(s):
        for j in range(s):
            total = Q[i, j]
            for k in range(s):
                total += work[i, k] * F[j, k]
            P[i, j] = total


@step
def _update(
    x: Rows, P: Rows, h: Rows, value: float, variance: float, gate: float, work: Rows
) -> None:
    """Use one scalar measurement."""
    s = x.shape[0]
    innovation, total = value, variance
    for i in range(s):
        innovation -= h[i] * x[i]
        work[0, i] = 0.0
        for j in range(s):
            work[0, i] += P[i, j] * h[j]
    for i in range(s):
        total += h[i] * work[0, i]
    total = max(total, innovation * innovation / (gate * gate))
    for i in range(s):
        x[i] += work[0, i] * innovation / total
    for i in range(s):
        for j in range(i, s):
            P[i, j] -= work[0, i] * work[0, j] / total
            P[j, i] = P[i, j]


@step
def backward(
    F: Rows,
    means: Rows,
    covariances: Rows,
    predicted: Rows,
    predicted_p: Rows,
    work: Rows,
    gain: Rows,
) -> None:
    """Smooth backward: `means` and `covariances` of `forward` become those given all measurements.

    `work` and `gain` are scratch, shape (2, s, s) and (s, s).
    """
    s = means.shape[1]
    for node in range(means.shape[0] - 2, -1, -1):
        for i in range(s):
            for j in range(s):
                work[0, i, j] = predicted_p[node + 1, i, j]
                total = 0.0
                for k in range(s):
                    total += F[i, k] * covariances[node, k, j]
                gain[i, j] = total
        _solve(work[0], gain)  # gain' = predicted^-1 F P
        for i in range(s):
            total = 0.0
            for k in range(s):
                total += gain[k, i] * (means[node + 1, k] - predicted[node + 1, k])
            work[1, 0, i] = total
        for i in range(s):
            means[node, i] += work[1, 0, i]
        for i in range(s):
            for j in range(s):
                total = 0.0
                for k in range(s):
                    difference = covariances[node + 1, k, j] - predicted_p[node + 1, k, j]
                    total += gain[k, i] * difference
                work[1, i, j] = total
        for i in range(s):
            for j in range(s):
                total = 0.0
                for k in range(s):
                    total += work[1, i, k] * gain[k, j]
                covariances[node, i, j] += total


@step
def _solve(A: Rows, B: Rows) -> None:
    """B = A^-1 B for a symmetric positive definite A, by Gaussian elimination; A is destroyed."""
    s = A.shape[0]
    for pivot in range(s):
        for i in range(pivot + 1, s):
            share = A[i, pivot] / A[pivot, pivot]
            if share != 0.0:
                for j in range(pivot, s):
                    A[i, j] -= share * A[pivot, j]
                for j in range(s):
                    B[i, j] -= share * B[pivot, j]
    for i in range(s - 1, -1, -1):
        for j in range(s):
            total = B[i, j]
            for k in range(i + 1, s):
                total -= A[i, k] * B[k, j]
            B[i, j] = total / A[i, i]

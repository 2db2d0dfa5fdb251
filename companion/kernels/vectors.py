"""Vectors of three components in the body frame: product, length, rotation."""

import math
from typing import Any

from numpy.typing import NDArray

from companion.jit import step

Vector = NDArray[Any]


@step
def dot(a: Vector, b: Vector) -> float:
    """Scalar product."""
    product: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


@step
def normalise(vector: Vector) -> None:
    """Scale to unit length, in place."""
    size = math.sqrt(dot(vector, vector))
    for i in range(3):
        vector[i] /= size


@step
def turn(direction: Vector, rate_b_radps: Vector, elapsed_s: float) -> None:
    """A unit vector fixed in space, as the body sees it after turning at `rate_b_radps`, in
    place."""
    rotate(direction, rate_b_radps, elapsed_s)
    normalise(direction)


@step
def rotate(vector: Vector, rate_b_radps: Vector, elapsed_s: float) -> None:
    """A vector of any length fixed in space, as the body sees it after turning at `rate_b_radps`,
    in place.

    Rodrigues' formula for the angle -rate dt.
    """
    x, y, z = (
        -rate_b_radps[0] * elapsed_s,
        -rate_b_radps[1] * elapsed_s,
        -rate_b_radps[2] * elapsed_s,
    )
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-12:
        cosine, sinc, versine = 1.0 - 0.5 * angle2, 1.0, 0.5
    else:
        angle = math.sqrt(angle2)
        cosine, sinc = math.cos(angle), math.sin(angle) / angle
        versine = (1.0 - cosine) / angle2
    along = versine * (x * vector[0] + y * vector[1] + z * vector[2])
    ux = cosine * vector[0] + sinc * (y * vector[2] - z * vector[1]) + along * x
    uy = cosine * vector[1] + sinc * (z * vector[0] - x * vector[2]) + along * y
    uz = cosine * vector[2] + sinc * (x * vector[1] - y * vector[0]) + along * z
    vector[0], vector[1], vector[2] = ux, uy, uz

"""The compiled part of `companion.intake.rows`: what a reading becomes on the vehicle's clock."""

import numpy as np

from companion.jit import step
from companion.samples import Rows

LARGEST_DOUBT_M = 30.0
"""Largest common error of the fixes that may be published: estimators assume that errors average
out."""
INTAKE = np.dtype([("air_us", "i8")], align=True)
INTAKE_PARAMS = np.dtype(
    [
        ("latency_us", "i8"),
        ("air_excess_k", "f8"),
        ("equal_heights", "i8"),  # what a fix with equal heights is: one of the following
    ],
    align=True,
)
RIGHT, UNSETTLED, DOUBTED = 0, 1, 2
"""sea level's height, for the pipeline to find out, in doubt"""


@step
def air_time(i: Rows, time_us: int) -> int:
    """Samples of the air come from several sources: each is newer than the one before."""
    i[0].air_us = time_us if time_us > i[0].air_us else i[0].air_us + 1
    return i[0].air_us

"""Items that a log's reader gives to the pipeline, in the order of the file.

A telemetry log gives MAVLink frames. An autopilot's own log has no frames: it gives readings in SI
units, heights to compare with, and frames of a HEARTBEAT made up once a second, so that vehicle,
arming and health are found by the same code.
"""

from typing import NamedTuple, TypeAlias

from companion.mavlink.codec import Frame
from companion.mavlink.convert import Reading


class Sensed(NamedTuple):
    """A reading, and which of the log's tables it is from."""

    source: int
    """tells sensors with own clocks apart, as message ids do; above every MAVLink id"""
    reading: Reading


class Height(NamedTuple):
    """A height to compare with: a simulator's truth, or the autopilot's own."""

    is_truth: bool
    time_us: int
    altitude_amsl_m: float
    climb_mps: float


class Throttle(NamedTuple):
    """What the pilot or autopilot asks of the motors; no estimator uses it."""

    time_us: int
    share: float
    """0 to 1"""


Item: TypeAlias = Frame | Sensed | Height | Throttle

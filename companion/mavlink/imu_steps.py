"""The compiled rules of `companion.mavlink.imu`: gravity, and which of the vehicle's messages with
an IMU or a pressure are used."""

import math

import numpy as np

from companion.jit import step
from companion.kernels.atmosphere import G0_MPS2
from companion.samples import Record, Rows

NONE_US = -(1 << 62)
SOURCE_TIMEOUT_US = 2_000_000
PRESSURE_TIMEOUT_US = 2_000_000
GRAVITY_WINDOW_US = 10_000_000
GRAVITY_SPACING_US = 100_000
KNOWN_AFTER_US = 5_000_000
LOWEST_G, HIGHEST_G = 0.8, 1.25
LOWEST_BORNE_G, HIGHEST_BORNE_G = 0.2, 8.0
"""bounds over seconds, once gravity has been seen: 1.4 g in a turn at 45 degrees of bank, 1.6 on a
fighter's runway"""
WINDOW = 128
"""places for the values of a window: 102 at most"""
CHECKS = 8
"""sensors of all messages"""
RANKS = 3

GRAVITY = np.dtype(
    [
        ("number", "i8"),  # of the sensor; -1 is a free place
        ("plausible", "i8"),
        ("count", "i8"),
        ("first", "i8"),  # place of the oldest value
        ("times_us", "i8", (WINDOW,)),
        ("forces", "f8", (WINDOW,)),  # m/s2, in order of time
        ("sorted", "f8", (WINDOW,)),  # the same, by size
    ],
    align=True,
)
CHOICE = np.dtype(
    [
        ("heard_us", "i8", (RANKS,)),
        ("checks", GRAVITY, (CHECKS,)),
        ("scaled_pressure_us", "i8"),  # when SCALED_PRESSURE was heard
    ],
    align=True,
)


@step
def begin(c: Rows) -> None:
    """Know nothing."""
    for i in range(RANKS):
        c[0].heard_us[i] = NONE_US
    for i in range(CHECKS):
        c[0].checks[i].number = -1
    forget_pressure(c)


@step
def forget_pressure(c: Rows) -> None:
    """The vehicle booted: its barometer may be sent in another message."""
    c[0].scaled_pressure_us = -PRESSURE_TIMEOUT_US


@step
def replaces_pressure(c: Rows, is_highres: bool, instance: int, now_us: int) -> bool:
    """Whether SCALED_PRESSURE replaces a pressure, of HIGHRES_IMU or its own."""
    if is_highres:
        return now_us - c[0].scaled_pressure_us < PRESSURE_TIMEOUT_US
    if instance == 0:
        c[0].scaled_pressure_us = now_us
    return False


@step
def accepts(
    c: Rows, number: int, rank: int, x_mps2: float, y_mps2: float, z_mps2: float, time_us: int
) -> bool:
    """Whether no better source replaces an IMU reading and gravity does not refute it.

    Parameters
    ----------
    number : of the message and the instance.
    rank : of the message among those of the primary IMU, 0 is the best; -1 of another IMU.
    time_us : the vehicle's clock when the message was heard.
    """
    force_mps2 = math.sqrt(x_mps2 * x_mps2 + y_mps2 * y_mps2 + z_mps2 * z_mps2)
    place = CHECKS - 1
    for i in range(CHECKS):
        if c[0].checks[i].number < 0:
            _empty(c[0].checks[i], number)
        if c[0].checks[i].number == number:
            place = i
            break
    if not is_plausible(c[0].checks[place], time_us, force_mps2):
        return False  # what gravity refutes replaces nothing
    if rank < 0:
        return True
    c[0].heard_us[rank] = time_us
    for better in range(rank):
        heard_us = c[0].heard_us[better]
        if heard_us != NONE_US and abs(time_us - heard_us) < SOURCE_TIMEOUT_US:
            return False
    return True


@step
def plausible(check: Rows, time_us: int, force_mps2: float) -> bool:
    """`is_plausible` of a GRAVITY row."""
    return is_plausible(check[0], time_us, force_mps2)


@step
def _empty(g: Record, number: int) -> None:
    g.number, g.plausible, g.count, g.first = number, 0, 0, 0


@step
def is_plausible(g: Record, time_us: int, force_mps2: float) -> bool:
    """Add a magnitude and say whether the source is plausible now; a clock that went back starts
    anew."""
    if not math.isfinite(force_mps2):
        return False
    newest = (g.first + g.count - 1) % WINDOW
    if g.count and time_us < g.times_us[newest] - SOURCE_TIMEOUT_US:
        g.count, g.plausible = 0, 0
    if g.count and time_us - g.times_us[newest] < GRAVITY_SPACING_US:
        return g.plausible == 1
    _add(g, time_us, force_mps2)
    while time_us - g.times_us[g.first] > GRAVITY_WINDOW_US or g.count == WINDOW:
        _drop(g)
    known = g.plausible and time_us - g.times_us[g.first] >= KNOWN_AFTER_US
    lowest_g, highest_g = LOWEST_G, HIGHEST_G
    if known:
        lowest_g, highest_g = LOWEST_BORNE_G, HIGHEST_BORNE_G
    half = g.count // 2
    median = g.sorted[half] if g.count % 2 else 0.5 * (g.sorted[half - 1] + g.sorted[half])
    g.plausible = 1 if lowest_g * G0_MPS2 <= median <= highest_g * G0_MPS2 else 0
    return g.plausible == 1


@step
def _add(g: Record, time_us: int, force: float) -> None:
    """Add the newest value."""
    place, at = (g.first + g.count) % WINDOW, g.count
    g.times_us[place], g.forces[place] = time_us, force
    while at > 0 and g.sorted[at - 1] > force:
        g.sorted[at] = g.sorted[at - 1]
        at -= 1
    g.sorted[at] = force
    g.count += 1


@step
def _drop(g: Record) -> None:
    """Drop the oldest value."""
    force, at = g.forces[g.first], 0
    while g.sorted[at] != force:
        at += 1
    for i in range(at, g.count - 1):
        g.sorted[i] = g.sorted[i + 1]
    g.first, g.count = (g.first + 1) % WINDOW, g.count - 1

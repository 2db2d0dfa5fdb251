"""Gains of the damping loop from a flight, by the paper's genetic algorithm: `kollsman tune
LOG --estimator damping-loop`.

J. Keighobadi, H. Nourmohammadi, S. Rafatnia, section III. A string of 15 bits holds the three
gains, 5 bits each, on [0, 3], [0, 1] and [0, 1]: its own result (3.00, .6452, .8710) is 31/31,
20/31 and 27/31 of them. The cost is (7), the squared difference between GNSS vertical velocity and
the loop's, here as a mean over the flight. A generation takes pairs by tournament, makes two
children of each by one-point crossover (probability .9) and two more by flipping bits with the
probability (8), and the best of old and new remain; the best string and its nearest (9) always do.
Sixteen strings of 15 bits are the 240 of (8).

Where the log has no GNSS vertical velocity (MAVLink's GPS_RAW_INT has none), slopes of GNSS height
over four seconds, by least squares, are compared with the slopes of the loop's path at the same
instants: one linear operation on both, so that a manoeuvre within the four seconds is no error. An
error of the loop that comes and goes within them is not seen either, and GNSS noise adds to every
string's cost alike.

The loop is that of `companion.estimators.baro_inertial.damping_loop`, its inputs (vertical
acceleration, calibrated barometer height) are what that estimator made of the log since the
vehicle's last restart, sorted by time.
"""

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.config import Settings
from companion.errors import LogFormatError
from companion.estimators.baro_inertial import damping_loop
from companion.estimators.baro_inertial.damping_loop import DampingLoopSettings, advance, feed_back
from companion.estimators.baro_inertial.genetic import (
    GENERATIONS,
    PAPER_GAINS,
    STRING_BITS,
    Gains,
    Search,
    decode,
    search,
)
from companion.estimators.baro_inertial.inputs import (
    BARO_TIMEOUT_US,
    GATE_M,
    IMU_TIMEOUT_US,
    calibrated_m,
)
from companion.estimators.baro_inertial.loop_gains import BARO_ALONE, TWO_WS2, is_stable, poles
from companion.estimators.judging import ATTITUDE, GNSS, IMU, PRESSURE, STATUS, USED
from companion.jit import step
from companion.samples import ESTIMATE, Kind, Rows, SampleLog, Tables, readable, rows

Array = NDArray[Any]

SLOPE_US = 4_000_000
LEAST_FIXES = 30
"""fewer are no flight to tune by"""
LEAST_FIXES_A_WINDOW = 3

COURSE = np.dtype([("time_us", "i8"), ("kind", "i8"), ("value", "f8")], align=True)
"""Acceleration (IMU), calibrated height (PRESSURE), climb or, where the log has none, height
(GNSS)."""


@step
def note_inputs(
    state: Rows,
    params: Rows,
    tables: Tables,
    estimate: Rows,
    course: Rows,
    gnss_field: NDArray[Any],
) -> None:
    """Run the damping loop's steps over a log, and note what it feeds the loop with; NaN where
    nothing.

    `gnss_field` is what is noted of each row of the GNSS table.
    """
    for i in range(tables.order.size):
        kind, row = tables.order[i].kind, tables.order[i].row
        course[i].kind = kind
        course[i].value = math.nan
        if kind == IMU:
            sample = tables.imu[row : row + 1]
            if damping_loop.on_imu(state, params, sample, estimate) == USED:
                course[i].time_us, course[i].value = (
                    sample[0].time_us,
                    state[0].inputs.acceleration_mps2,
                )
        elif kind == PRESSURE:
            sample = tables.pressure[row : row + 1]
            if damping_loop.on_pressure(state, params, sample, estimate) == USED:
                inputs = state[0].inputs
                course[i].time_us = sample[0].time_us
                course[i].value = calibrated_m(
                    inputs.level_m, inputs.start_level_m, inputs.start_height_m, inputs.scale
                )
        elif kind == GNSS:
            sample = tables.gnss[row : row + 1]
            if damping_loop.on_gnss(state, params, sample, estimate) == USED:
                course[i].time_us, course[i].value = sample[0].time_us, gnss_field[row]
        elif kind == ATTITUDE:
            damping_loop.on_attitude(state, params, tables.attitude[row : row + 1], estimate)
        elif kind == STATUS:
            damping_loop.on_status(state, params, tables.status[row : row + 1], estimate)


@step
def fly(state: Rows, params: Rows, course: Rows, velocities: Array, paths: Array) -> None:
    """The loop over a course: its velocity, and its path (the integral of velocity), at each
    fix."""
    s = state[0]
    fix, path, path_us, imu_us = 0, 0.0, 0, 0
    for i in range(course.size):
        kind, time_us, value = course[i].kind, course[i].time_us, course[i].value
        if kind == IMU:
            s.inputs.acceleration_mps2, imu_us = value, time_us
        elif time_us - imu_us > IMU_TIMEOUT_US:
            s.inputs.acceleration_mps2 = math.nan
        if s.running == 1:
            before = s.v
            advance(state, time_us)
            path += 0.5 * (before + s.v) * (time_us - path_us) * 1e-6
        path_us = time_us
        if kind == GNSS:
            velocities[fix], paths[fix] = s.v, path
            fix += 1
        elif kind == PRESSURE:
            error_m, T = s.h - value, (time_us - s.corrected_us) * 1e-6
            if s.running == 1 and T * 1e6 <= BARO_TIMEOUT_US and abs(error_m) <= GATE_M:
                feed_back(state, params, error_m, T)
            else:  # at the start, after a gap, and where these gains lose the barometer
                s.running, s.x_us, s.h = 1, time_us, value
                s.v = 0.0 if math.isnan(s.v) else s.v
            s.corrected_us = time_us


@step
def mean_square(errors: Array) -> float:
    """Mean square of the values that are known."""
    total, count = 0.0, 0
    for error in errors:
        if not math.isnan(error):
            total += error * error
            count += 1
    return total / count if count > 0 else math.nan


@step
def mean_square_slope(heights: Array, times_us: Array, windows: Array) -> float:
    """Mean square of the least-squares slopes of heights against time; a row of `windows` is (first
    fix, one past the last)."""
    total, count = 0.0, 0
    for k in range(windows.shape[0]):
        first, last = windows[k, 0], windows[k, 1]
        middle, height = 0.0, 0.0
        for i in range(first, last):
            middle += (times_us[i] - times_us[first]) * 1e-6 / (last - first)
            height += heights[i] / (last - first)
        moment, spread = 0.0, 0.0
        for i in range(first, last):
            offset_s = (times_us[i] - times_us[first]) * 1e-6 - middle
            moment += offset_s * (heights[i] - height)
            spread += offset_s * offset_s
        slope = moment / spread
        if not math.isnan(slope):
            total += slope * slope
            count += 1
    return total / count if count > 0 else math.nan


class Flight:
    """What the gains are tried on: the course of a log, and GNSS's velocity or height along it.

    Of `settings`, those of the damping loop, all but the gains matter: how the start is found, the
    temperature there.
    """

    def __init__(self, log: SampleLog, settings: Settings | None = None) -> None:
        climbs_mps = log[Kind.GNSS]["climb_mps"]
        self.has_velocity = bool(np.isfinite(climbs_mps).sum() > 0.5 * climbs_mps.size)
        noted = climbs_mps if self.has_velocity else log[Kind.GNSS]["altitude_amsl_m"]
        params: Rows = (settings or DampingLoopSettings()).params()  # type: ignore[attr-defined]
        course = readable(np.zeros(len(log), COURSE))
        state, estimate = damping_loop.init(params), rows(ESTIMATE)
        note_inputs(state, params, log.tables, estimate, course, np.ascontiguousarray(noted))
        self.course = _checked(course[_last_boot(log) :])
        fixes = self.course[self.course["kind"] == GNSS]
        self._params = params.copy()
        self._times_us = np.ascontiguousarray(fixes["time_us"])
        self._reference = np.ascontiguousarray(fixes["value"])
        self._windows = _windows(self._times_us)
        self._velocities, self._paths = np.zeros(len(fixes)), np.zeros(len(fixes))

    def cost(self, gains: Gains) -> float:
        """(7) as a mean, (m/s)^2; infinite for gains that are unstable."""
        if not is_stable(*gains):
            return math.inf
        params = self._params
        params["poles"], params["baro_alone_poles"] = poles(*gains), poles(*BARO_ALONE)
        fly(damping_loop.init(params), params, self.course, self._velocities, self._paths)
        if self.has_velocity:
            return float(mean_square(self._velocities - self._reference))
        return float(
            mean_square_slope(self._paths - self._reference, self._times_us, self._windows)
        )


def _last_boot(log: SampleLog) -> int:
    """Where in the order of samples the vehicle last restarted; 0 if it did not."""
    order = log.tables.order
    status = np.flatnonzero(order["kind"] == STATUS)
    reboots = status[log[Kind.STATUS]["reboot"][order["row"][status]] == 1]
    return int(reboots[-1]) if reboots.size else 0


def _checked(course: Rows) -> Rows:
    """What is known of a course, from the start on, sorted by time. Raises `LogFormatError` when it
    is no flight."""
    course = course[np.isfinite(course["value"])]
    if not np.any(course["kind"] == IMU):
        raise LogFormatError(
            "the log's IMU is missing or slower than 10 Hz: no gains can be found from it"
        )
    heights = course["kind"] == PRESSURE
    if not heights.any():
        raise LogFormatError(
            "the log has no barometer with GNSS heights to start from: no gains can be found from "
            "it"
        )
    course = course[course["time_us"] >= course["time_us"][heights].min()]
    if np.count_nonzero(course["kind"] == GNSS) < LEAST_FIXES:
        raise LogFormatError(
            f"the log has fewer than {LEAST_FIXES} GNSS fixes: no gains can be found from it"
        )
    return readable(course[np.argsort(course["time_us"], kind="stable")])


def _windows(times_us: Array) -> Array:
    """(first fix, one past the last) of spans of `SLOPE_US`, each beginning in the middle of the
    one before."""
    starts = np.arange(times_us[0], times_us[-1] - SLOPE_US, SLOPE_US // 2)
    windows = np.stack(
        [np.searchsorted(times_us, starts), np.searchsorted(times_us, starts + SLOPE_US)], axis=1
    )
    return np.ascontiguousarray(windows[windows[:, 1] - windows[:, 0] >= LEAST_FIXES_A_WINDOW])


@dataclass(frozen=True)
class Tuning:
    """Gains for a flight, and how good they are."""

    gains: Gains
    found: Search
    paper_cost: float
    """cost of the paper's gains on the same flight"""
    has_velocity: bool
    """whether the log had GNSS vertical velocity"""

    @property
    def poles(self) -> tuple[complex, complex, complex]:
        """Poles of the continuous loop, 1/s."""
        return loop_poles(self.gains)

    @property
    def damping(self) -> float:
        """Damping ratio of the least damped poles."""
        return damping(self.gains)

    def table(self) -> str:
        """The gains beside the paper's, and how they were found."""
        source = "GNSS vertical velocity" if self.has_velocity else "slopes of GNSS height"
        lines = [
            f"against {source}; {self.found.evaluations} of {2**STRING_BITS} strings tried in "
            f"{len(self.found.history) - 1} generations",
            f"{'':14s}{'K1':>7s}{'K2':>8s}{'K3':>8s}{'cost (m/s)2':>13s}{'damping':>9s}  poles "
            "(1/s)",
        ]
        for name, gains, cost in (
            ("found", self.gains, self.found.cost),
            ("the paper's", PAPER_GAINS, self.paper_cost),
        ):
            values = "".join(f"{gain:8.4f}" for gain in gains)
            shown = ", ".join(
                f"{pole.real:.4f}{pole.imag:+.4f}i" if pole.imag else f"{pole.real:.4f}"
                for pole in loop_poles(gains)
            )
            lines.append(f"{name:13s}{values}{cost:13.5f}{damping(gains):9.3f}  {shown}")
        if self.gains[2] == 0.0:
            lines.append("K3 = 0: a bias of the accelerometer is not compensated")
        return "\n".join(lines)

    def snippet(self) -> str:
        """Lines for companion.yaml."""
        values = "".join(f"    k{place}: {gain:.6g}\n" for place, gain in enumerate(self.gains, 1))
        return (
            f"estimator: {damping_loop.METHOD.name}\nestimators:\n  "
            f"{damping_loop.METHOD.name}:\n{values}"
        )


def loop_poles(gains: Gains) -> tuple[complex, complex, complex]:
    """Poles of (6), 2 w_s^2 included, 1/s."""
    real, mean, split = poles(gains[0], gains[1] - TWO_WS2, gains[2])
    half = cmath.sqrt(split)
    return complex(real), mean + half, mean - half


def damping(gains: Gains) -> float:
    """Damping ratio of the least damped poles; 0 with a pole at the origin."""
    return min(-pole.real / abs(pole) if pole else 0.0 for pole in loop_poles(gains))


def tune(
    log: SampleLog,
    settings: Settings | None = None,
    seed: int = 0,
    generations: int = GENERATIONS,
    on_progress: Callable[[float], None] | None = None,
) -> Tuning:
    """Search the gains of the damping loop for a log. Raises `LogFormatError` when the log cannot
    serve."""
    flight = Flight(log, settings)
    random = np.random.default_rng(np.random.SeedSequence(seed))
    found = search(lambda string: flight.cost(decode(string)), random, generations, on_progress)
    return Tuning(decode(found.string), found, flight.cost(PAPER_GAINS), flight.has_velocity)

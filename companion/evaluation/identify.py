"""The coefficients of a vehicle's barometer from its logs, as the parameters its autopilot has for
them."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from companion.errors import LogFormatError
from companion.evaluation.coefficients import (
    PORTS,
    REFERENCE_K,
    Coefficient,
    Flight,
    coefficients,
)
from companion.evaluation.metrics import Array
from companion.evaluation.samples import Sampler, Tap
from companion.kernels.atmosphere import G0_MPS2, R_AIR, T0_K, baro_altitude_array
from companion.logs import open_log
from companion.mavlink.codec import Message, mavlink
from companion.recorded import Item, Throttle
from companion.replay.sessions import sessions_of
from companion.samples import Kind, Rows
from companion.settings import CompanionSettings

STEP_S, MOST_NODES = 2.0, 800
SEA_LEVEL_DENSITY_KGPM3 = 1.225
REST_MPS, REST_THROTTLE, SHORTEST_REST_NODES = 0.5, 0.12, 5
STILL_M = 8.0
"""GNSS heights of a rest lie within this"""
SHORTEST_S = 60.0
LAPSE_KPM, COLDEST_K = 0.0065, 216.65
VFR_HUD = mavlink.MAVLINK_MSG_ID_VFR_HUD
PARAMETERS = {
    "forward": ("BARO1_WCF_FWD", "EKF2_PCOEF_XP"),
    "backward": ("BARO1_WCF_BCK", "EKF2_PCOEF_XN"),
    "right": ("BARO1_WCF_RGT", "EKF2_PCOEF_YP"),
    "left": ("BARO1_WCF_LFT", "EKF2_PCOEF_YN"),
}
"""of ArduPilot and PX4: static pressure error over dynamic pressure of the air from there"""

UNITS = {
    **{name: (f"static port, {name}", "of dynamic pressure") for name in PORTS},
    "thrust": ("thrust", "Pa at full throttle"),
    "thermal": ("temperature", "Pa/K"),
}
"""name and unit of a coefficient, for people"""


class Gathered(Tap):
    """The samples of a session, with its throttle."""

    def __init__(self) -> None:
        super().__init__()
        self.throttle: list[tuple[int, float]] = []
        """(time_us, share)"""


class Gatherer(Sampler):
    """A pipeline without an estimator that also keeps the throttle."""

    def feed_item(self, item: Item, arrival_us: int) -> list[bytes]:
        if isinstance(item, Throttle):
            self._note(item.time_us, item.share)
        return super().feed_item(item, arrival_us)

    def _message(self, message: Message, message_id: int, arrival_us: int) -> list[bytes]:
        if message_id == VFR_HUD and self.now_us >= 0:
            self._note(self.now_us, message.throttle / 100.0)
        return super()._message(message, message_id, arrival_us)

    def _note(self, time_us: int, share: float) -> None:
        target = getattr(self._observer, "target", self._observer)
        if isinstance(target, Gathered):
            target.throttle.append((time_us, share))


class Identified(NamedTuple):
    """What the logs say."""

    coefficients: list[Coefficient]
    sessions: int
    die_c: tuple[float, float]
    """lowest and highest temperature of the barometer, degrees Celsius; NaN unknown"""


def identify(
    paths: Sequence[Path],
    settings: CompanionSettings | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> Identified:
    """The coefficients from every session of the logs, which must be of one vehicle.

    Raises `LogFormatError` when a log cannot be read, or no session has both a barometer and GNSS.
    """
    flights = []
    for number, path in enumerate(paths):
        sessions = sessions_of(
            open_log(path), settings or CompanionSettings(), lambda _: Gathered(), Gatherer
        )
        flights += [flight for each in sessions if (flight := flight_of(each.seen)) is not None]
        if on_progress is not None:
            on_progress((number + 1) / (len(paths) + 1))
    if not flights:
        raise LogFormatError(
            f"{paths[0]}: no session of a minute with both a barometer and a GNSS height"
        )
    found = coefficients(flights)
    die = np.concatenate([each.die_k for each in flights])
    die = die[np.isfinite(die)] - (T0_K - 15.0)
    span = (float(die.min()), float(die.max())) if die.size else (math.nan, math.nan)
    return Identified(found, len(flights), span)


def flight_of(seen: Gathered) -> Flight | None:
    """The session on nodes; None when it is too short, or has no barometer or no GNSS."""
    log = seen.log
    baro, gnss = log[Kind.PRESSURE], log[Kind.GNSS]
    baro = baro[np.asarray(baro["instance"]) == 0]
    gnss = gnss[(np.asarray(gnss["instance"]) == 0) & (np.asarray(gnss["fix_type"]) >= 3)]
    if baro.size < 2 or gnss.size < 2:
        return None
    start_s = max(int(baro["time_us"][0]), int(gnss["time_us"][0])) * 1e-6
    end_s = min(int(baro["time_us"][-1]), int(gnss["time_us"][-1])) * 1e-6
    if end_s - start_s < SHORTEST_S:
        return None
    step_s = max(STEP_S, (end_s - start_s) / MOST_NODES)
    time_s = np.arange(start_s, end_s, step_s)
    grid = _Grid(time_s, step_s)
    baro_m = grid.mean(baro, baro_altitude_array(baro["pressure_pa"]))
    gnss_m = grid.mean(gnss, gnss["altitude_amsl_m"])
    temperature_k = np.maximum(COLDEST_K, T0_K - LAPSE_KPM * np.nan_to_num(baro_m))
    pressure_pa = grid.mean(baro, baro["pressure_pa"])
    heads_pa, wind = _heads(log.__getitem__, grid, pressure_pa / (R_AIR * temperature_k))
    throttle = grid.at(np.array(seen.throttle).reshape(-1, 2))
    return Flight(
        time_s,
        baro_m,
        gnss_m,
        grid.mean(gnss, gnss["vertical_sd_m"]),
        np.nan_to_num(pressure_pa, nan=101_325.0) * G0_MPS2 / (R_AIR * temperature_k),
        _climb(baro_m, step_s),
        heads_pa,
        wind,
        throttle,
        grid.mean(baro, baro["die_temperature_k"]),
        _rests(log[Kind.STATUS], grid, grid.mean(gnss, gnss["ground_speed_mps"]), throttle, gnss_m),
    )


def _climb(baro_m: Array, step_s: float) -> Array:
    """Slope of the barometer's height over five nodes: its own noise must not be taken for
    climb."""
    known = np.isfinite(baro_m)
    filled = np.interp(np.arange(baro_m.size), np.flatnonzero(known), baro_m[known])
    smooth = np.convolve(np.pad(filled, 2, mode="edge"), np.full(5, 0.2), mode="valid")
    return np.asarray(np.gradient(smooth, step_s))


class _Grid(NamedTuple):
    """Nodes, each the centre of one step."""

    time_s: Array
    step_s: float

    def mean(self, rows: Rows, values: Array) -> Array:
        """Mean of the values nearest to each node; NaN where there is none."""
        values = np.asarray(values, np.float64)
        node = np.rint((np.asarray(rows["time_us"]) * 1e-6 - self.time_s[0]) / self.step_s)
        known = np.isfinite(values) & (node >= 0) & (node < self.time_s.size)
        node = node[known].astype(np.int64)
        count = np.bincount(node, minlength=self.time_s.size)
        total = np.bincount(node, values[known], self.time_s.size)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)

    def at(self, series: Array) -> Array:
        """A series of (time_us, value), shape (n, 2), between its points; NaN when it is empty."""
        if not len(series):
            return np.full(self.time_s.size, np.nan)
        return np.interp(self.time_s, series[:, 0] * 1e-6, series[:, 1])


def _heads(tables: Callable[[Kind], Rows], grid: _Grid, density: Array) -> tuple[Array, Array]:
    """Dynamic pressure from each side (Pa), shape (4, n), and the terms of the wind, (2, n).

    From the airspeed, which is forward, where there is one; else from the GNSS velocity, turned by
    the vehicle's yaw where it is known.
    """
    heads, none = np.full((4, grid.time_s.size), np.nan), np.zeros((2, grid.time_s.size))
    airspeed = tables(Kind.AIRSPEED)
    airspeed = airspeed[np.asarray(airspeed["instance"]) == 0]
    speed = grid.mean(airspeed, airspeed["airspeed_mps"])
    if np.isfinite(speed).sum() > 0.5 * speed.size:
        heads[0] = 0.5 * SEA_LEVEL_DENSITY_KGPM3 * speed**2
        return heads, none
    gnss, attitude = tables(Kind.GNSS), tables(Kind.ATTITUDE)
    ground, course = np.asarray(gnss["ground_speed_mps"]), np.asarray(gnss["course_rad"])
    north, east = grid.mean(gnss, ground * np.cos(course)), grid.mean(gnss, ground * np.sin(course))
    still = np.isfinite(grid.mean(gnss, ground)) & ~np.isfinite(north)
    north, east = np.where(still, 0.0, north), np.where(still, 0.0, east)
    half = 0.5 * density
    yaw = np.asarray(attitude["yaw_rad"])
    cos, sin = grid.mean(attitude, np.cos(yaw)), grid.mean(attitude, np.sin(yaw))
    if np.isfinite(cos).sum() < 0.5 * cos.size:
        heads[0] = half * (north**2 + east**2)
    else:
        forward, right = north * cos + east * sin, east * cos - north * sin
        for i, along in enumerate((forward, -forward, right, -right)):
            heads[i] = half * np.square(np.maximum(0.0, along))
    return heads, np.stack([density * north, density * east])


def _rests(
    status: Rows, grid: _Grid, ground_mps: Array, throttle: Array, gnss_m: Array
) -> list[tuple[int, int]]:
    """[first, end) nodes of each rest: no speed, and disarmed or the throttle closed."""
    told = status[np.asarray(status["armed"]) >= 0]
    armed = grid.at(np.stack([np.asarray(told["time_us"]), np.asarray(told["armed"])], axis=1))
    quiet = (armed == 0) | (throttle < REST_THROTTLE)
    still = np.concatenate([[False], quiet & ~(ground_mps > REST_MPS), [False]])
    edges = np.flatnonzero(np.diff(still.astype(np.int8)))
    rests = []
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        heights = gnss_m[first:end][np.isfinite(gnss_m[first:end])]
        if end - first >= SHORTEST_REST_NODES and heights.size and np.ptp(heights) <= STILL_M:
            rests.append((first, end))
    return rests


class Line(NamedTuple):
    """A parameter of an autopilot with the value that corrects the error."""

    autopilot: str
    parameter: str
    value: float
    remark: str = ""


def parameters(found: Identified) -> list[Line]:
    """The parameters of what was seen, for ArduPilot and PX4."""
    seen = {each.name: each for each in found.coefficients if each.is_seen}
    lines = []
    if any(name in PARAMETERS for name in seen):
        lines.append(Line("ArduPilot", "BARO1_WCF_ENABLE", 1))
    for name, (ardupilot, px4) in PARAMETERS.items():
        if name in seen:
            lines += [
                Line(each, key, round(seen[name].value, 4))
                for each, key in (("ArduPilot", ardupilot), ("PX4", px4))
            ]
    if "thrust" in seen:
        lines.append(Line("ArduPilot", "BARO1_THST_SCALE", round(seen["thrust"].value, 1)))
    if "thermal" in seen:
        lines += _thermal(seen["thermal"].value, *found.die_c)
    return sorted(lines, key=lambda line: line.autopilot)


def _thermal(slope_pa_per_k: float, coldest_c: float, hottest_c: float) -> list[Line]:
    """ArduPilot adds (T - 25 degC)^TCAL_BARO_EXP pascals above 25 degC, PX4 subtracts a
    polynomial."""
    reference_c = REFERENCE_K - (T0_K - 15.0)
    lines = [
        Line("PX4", "TC_B_ENABLE", 1),
        Line("PX4", "TC_B0_TREF", reference_c),
        Line("PX4", "TC_B0_TMIN", math.floor(coldest_c)),
        Line("PX4", "TC_B0_TMAX", math.ceil(hottest_c)),
        Line("PX4", "TC_B0_X1", round(slope_pa_per_k, 3), "Pa/K"),
    ]
    above = np.linspace(max(0.0, coldest_c - reference_c), hottest_c - reference_c, 50)
    if slope_pa_per_k > 0 or hottest_c - reference_c < 1.0:
        return lines
    exponents = np.arange(0.0, 2.0005, 0.001)
    misfit = np.std(np.power.outer(above, exponents) + slope_pa_per_k * above[:, None], axis=0)
    best = int(np.argmin(misfit))
    remark = (
        f"leaves {misfit[best]:.1f} Pa between {max(25.0, coldest_c):.0f} and {hottest_c:.0f} degC"
    )
    return [
        *lines,
        Line("ArduPilot", "TCAL_ENABLED", 1),
        Line("ArduPilot", "TCAL_TEMP_MIN", math.floor(max(reference_c, coldest_c))),
        Line("ArduPilot", "TCAL_TEMP_MAX", math.ceil(hottest_c)),
        Line("ArduPilot", "TCAL_BARO_EXP", round(float(exponents[best]), 3), remark),
    ]

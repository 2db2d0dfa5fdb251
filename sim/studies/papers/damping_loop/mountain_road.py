"""A car on a mountain road, for paper K: truth and samples.

From 1350 m (Tabriz) 600 m up in five minutes, on a day 15 K warmer and 8 hPa lower than standard at
sea level:

===================  ===============================================================================
accelerometer 20 Hz  0.1 m/s2 white, 0.2 m/s2 bias, 0.1 m/s2 / 60 s Gauss-Markov (attitude)
barometer 10 Hz      0.3 m white, 1 m / 60 s Gauss-Markov (wind and ventilation around a car)
GPS 1 Hz             climb 0.1 m/s white, height 2 m white
===================  ===============================================================================

The car is level: its specific force is along the vertical, so that nothing but the vertical channel
is tried.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.samples import DTYPES, Kind, Rows, SampleLog, readable

Array = NDArray[np.float64]

T0_K, P0_PA, LAPSE_KPM, GAS, G_MPS2 = 288.15, 101_325.0, 0.0065, 287.05287, 9.80665

DURATION_S, IMU_HZ, BARO_HZ, GPS_HZ = 300, 20, 10, 1
START_S = 20.0
"""vehicle time at the start; the first seconds stand still"""
SETTLE_S = 60.0
START_M, WARMER_K, LOWER_PA = 1350.0, 15.0, 800.0
LATITUDE_DEG, GRAVITY_MPS2 = 38.07, 9.7999
FORCE_SD, FORCE_BIAS, FORCE_WANDER, FORCE_TIME_S = 0.1, 0.2, 0.1, 60.0
BARO_SD_M, BARO_WANDER_M, BARO_TIME_S = 0.3, 1.0, 60.0
CLIMB_SD_MPS, GPS_SD_M = 0.1, 2.0


@dataclass(frozen=True)
class Drive:
    """One drive: truth at the IMU's instants, and what the sensors made of it."""

    time_s: Array
    altitude_m: Array
    climb_mps: Array
    log: SampleLog

    @property
    def late(self) -> NDArray[np.bool_]:
        return self.time_s > SETTLE_S


def climb_mps(time_s: Array) -> Array:
    """Up a mountain road, steeper and flatter, from a standstill."""
    gone = np.clip((time_s - 5.0) / 10.0, 0.0, 1.0)
    return np.asarray(
        gone * (2.1 + np.sin(2 * np.pi * time_s / 120.0) + 0.5 * np.sin(2 * np.pi * time_s / 37.0))
    )


def wander(
    random: np.random.Generator, count: int, interval_s: float, sd: float, time_s: float
) -> Array:
    """First-order Gauss-Markov process."""
    kept = math.exp(-interval_s / time_s)
    noise = random.normal(0.0, sd * math.sqrt(1.0 - kept * kept), count)
    value = random.normal(0.0, sd)
    found = np.empty(count)
    for k in range(count):
        found[k] = value = kept * value + noise[k]
    return found


def pressure_pa(altitude_m: Array) -> Array:
    """The day's column of air: its own sea level, the standard's lapse rate."""
    geopotential_m = 6_356_766.0 * altitude_m / (6_356_766.0 + altitude_m)
    share = 1.0 - LAPSE_KPM * geopotential_m / (T0_K + WARMER_K)
    return np.asarray((P0_PA - LOWER_PA) * share ** (G_MPS2 / (GAS * LAPSE_KPM)))


def drive(random: np.random.Generator, duration_s: int = DURATION_S) -> Drive:
    """Five minutes up the road."""
    fine_s = np.arange(duration_s * IMU_HZ * 5 + 1) / (IMU_HZ * 5.0)
    climb = climb_mps(fine_s)
    altitude = START_M + np.concatenate(
        [[0.0], np.cumsum(0.5 * (climb[1:] + climb[:-1]) * np.diff(fine_s))]
    )

    imu_s, baro_s, gps_s = (
        np.arange(1, duration_s * rate + 1) / rate for rate in (IMU_HZ, BARO_HZ, GPS_HZ)
    )
    upward = np.diff(np.interp(np.concatenate([[0.0], imu_s]), fine_s, climb)) * IMU_HZ
    error = FORCE_BIAS + wander(random, imu_s.size, 1 / IMU_HZ, FORCE_WANDER, FORCE_TIME_S)
    error += random.normal(0.0, FORCE_SD, imu_s.size)
    imu = _table(Kind.IMU, imu_s)
    gravity = GRAVITY_MPS2 - 3.086e-6 * np.interp(imu_s, fine_s, altitude)
    imu["specific_force_b_mps2"] = 0.0
    imu["specific_force_b_mps2"][:, 2] = -(gravity + upward + error)
    imu["angular_rate_b_radps"] = 0.0

    wrong_m = wander(random, baro_s.size, 1 / BARO_HZ, BARO_WANDER_M, BARO_TIME_S)
    wrong_m += random.normal(0.0, BARO_SD_M, baro_s.size)
    pressure = _table(Kind.PRESSURE, baro_s + 0.001)
    pressure["pressure_pa"] = pressure_pa(np.interp(baro_s + 0.001, fine_s, altitude) + wrong_m)

    gps = _table(Kind.GNSS, gps_s + 0.002)
    gps["latitude_deg"], gps["longitude_deg"], gps["fix_type"], gps["vertical_sd_m"] = (
        LATITUDE_DEG,
        46.3,
        3,
        GPS_SD_M,
    )
    gps["altitude_amsl_m"] = np.interp(gps_s + 0.002, fine_s, altitude) + random.normal(
        0.0, GPS_SD_M, gps_s.size
    )
    gps["climb_mps"] = np.interp(gps_s + 0.002, fine_s, climb) + random.normal(
        0.0, CLIMB_SD_MPS, gps_s.size
    )

    log = log_of({Kind.IMU: imu, Kind.PRESSURE: pressure, Kind.GNSS: gps})
    return Drive(imu_s, np.interp(imu_s, fine_s, altitude), np.interp(imu_s, fine_s, climb), log)


def _table(kind: Kind, time_s: Array) -> Rows:
    table = np.zeros(time_s.size, DTYPES[kind])
    for name, (dtype, *_) in (DTYPES[kind].fields or {}).items():
        if dtype.base.kind == "f":
            table[name] = np.nan
    table["time_us"] = table["arrival_us"] = np.round((START_S + time_s) * 1e6)
    return table


def log_of(tables: dict[Kind, Rows]) -> SampleLog:
    """Tables as a log, in order of time."""
    log = SampleLog()
    times = np.concatenate([table["time_us"] for table in tables.values()])
    kinds = np.concatenate([np.full(table.size, int(kind)) for kind, table in tables.items()])
    places = np.concatenate([np.arange(table.size) for table in tables.values()])
    views = {int(kind): readable(table) for kind, table in tables.items()}
    for i in np.argsort(times, kind="stable"):
        log.append(Kind(kinds[i]), views[int(kinds[i])][places[i] : places[i] + 1])
    return log

"""Garmin G1000 logs (CSV, 1 Hz): real air, real path, SBAS truth.

Real are the pressure at the static port (indicated altitude and altimeter setting, inverted by the
standard atmosphere), the path, attitude, airspeed and outside air temperature; the truth is the
SBAS altitude. Laid on are the error of a cheap receiver, barometer noise of 1 Pa, and an inertial
sensor whose specific force and rates follow from splines through path and attitude, with bias and
noise of a cheap part. The same file, seed and Gauss-Markov error give the numbers of
``make_flights.py`` beside the shared flights.
"""

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.errors import LogFormatError
from companion.samples import Kind, Rows, SampleLog
from sim.constants import EQUATORIAL_RADIUS_M, G0_MPS2, ZERO_CELSIUS_K
from sim.studies.real.gnss_errors import STEP_S, GnssError
from sim.studies.real.recording import (
    Plan,
    Recording,
    elevation_row,
    status_rows,
    table,
    truth_rows,
)

Array = NDArray[np.float64]

FT_M, INHG_HPA, KT_MPS = 0.3048, 33.8639, 0.514444
LATENCY_US = 120_000
"""latency that the intake subtracts from a GNSS time stamp"""
TICKS = {"pressure": 5, "gnss": 10, "second": 50}
ACCEL_BIAS_MPS2, GYRO_BIAS_RADPS, ACCEL_SD_MPS2, GYRO_SD_RADPS = 0.08, 0.003, 0.05, 0.005
NUMBERS = (
    "Latitude", "Longitude", "AltMSL", "BaroA", "OAT", "IAS", "GndSpd", "TRK", "HDG", "Pitch",
    "Roll", "AltB", "AltInd",
)  # fmt: skip
NEEDED = ("Latitude", "Longitude", "AltMSL", "BaroA")


class G1000(Recording):
    """One G1000 log."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._time_s, self._columns = _read(path)
        self._splines = _splines(self._time_s, self._columns)
        self.duration_s = float(self._time_s[-1] - self._time_s[0]) - 4.0

    @classmethod
    def recognises(cls, path: Path) -> bool:
        if path.suffix.lower() != ".csv":
            return False
        with path.open(encoding="utf-8", errors="replace") as file:
            head = [file.readline() for _ in range(5)]
        return any("Lcl Date" in line and "BaroA" in line for line in head)

    def samples(self, plan: Plan, error: GnssError | None) -> SampleLog:
        t, start_s = self._time_s, self._time_s[0] + 2.0
        at = np.arange(start_s, t[-1] - 2.0, STEP_S)
        elapsed_s = at - start_s + 1.0
        height_m = self._splines["h"](at - plan.lag_s)
        climb_mps = self._splines["h"](at - plan.lag_s, 1)
        random = np.random.default_rng(plan.seed)
        fixes = error.at(at - start_s, random) if error is not None else None
        every = max(1, 50 // plan.imu_hz) if plan.imu_hz else 0
        noise = _Noise(random, at.size, every)
        nearest = np.minimum(np.searchsorted(t, at), t.size - 1)
        tables: dict[Kind, Rows] = {Kind.STATUS: status_rows(elapsed_s[-1])}
        if every:
            tables[Kind.IMU] = self._imu(at, elapsed_s, plan, noise, every)
        tables[Kind.PRESSURE] = self._pressure(at, elapsed_s, nearest, noise)
        if plan.attitude:
            tables[Kind.ATTITUDE] = self._attitude(at, elapsed_s)
        tables[Kind.GNSS] = self._gnss(at, elapsed_s, height_m, nearest, fixes)
        seconds = slice(None, None, TICKS["second"])
        ias_mps = _filled(t, self._columns["IAS"]) * KT_MPS
        tables[Kind.AIRSPEED] = table(
            Kind.AIRSPEED, elapsed_s[seconds], airspeed_mps=ias_mps[nearest[seconds]]
        )
        if plan.field_elevation:
            tables[Kind.AIR] = elevation_row(1.0, float(height_m[0]), plan.seed)
        chosen = slice(None, None, TICKS["pressure"])
        truth = truth_rows(elapsed_s[chosen], height_m[chosen], climb_mps[chosen])
        return SampleLog.of_tables(tables, truth)

    def _imu(self, at: Array, elapsed_s: Array, plan: Plan, noise: "_Noise", every: int) -> Rows:
        chosen = slice(None, None, every)
        time_s, s = at[chosen], self._splines
        down = -s["h"](time_s - plan.lag_s, 2) - G0_MPS2
        force_n = np.stack([s["n"](time_s, 2), s["e"](time_s, 2), down], axis=1)
        angles, rates = (
            [s[name](time_s, order) for name in ("roll", "pitch", "yaw")] for order in (0, 1)
        )
        force_b = np.einsum("kij,ki->kj", _mat_nb(*angles), force_n) + noise.accel
        rate_b = _body_rates(angles, rates) + noise.gyro
        return table(
            Kind.IMU,
            elapsed_s[chosen],
            specific_force_b_mps2=_counted(force_b * 1000.0 / G0_MPS2) * 1e-3 * G0_MPS2,
            angular_rate_b_radps=_counted(rate_b * 1000.0) * 1e-3,
        )

    def _pressure(self, at: Array, elapsed_s: Array, nearest: Any, noise: "_Noise") -> Rows:
        chosen = slice(None, None, TICKS["pressure"])
        hpa = (self._splines["p"](at[chosen]) + 0.01 * noise.pressure).astype(np.float32)
        oat_c = _filled(self._time_s, self._columns["OAT"], 15.0)[nearest[chosen]]
        made = table(
            Kind.PRESSURE,
            elapsed_s[chosen],
            pressure_pa=hpa.astype(np.float64) * 100.0,
            die_temperature_k=np.trunc(100.0 * (oat_c + 15.0)) * 0.01 + ZERO_CELSIUS_K,
        )
        return _milliseconds(made)

    def _attitude(self, at: Array, elapsed_s: Array) -> Rows:
        chosen = slice(None, None, TICKS["pressure"])
        angles, rates = (
            [self._splines[name](at[chosen], order) for name in ("roll", "pitch", "yaw")]
            for order in (0, 1)
        )
        made = table(
            Kind.ATTITUDE,
            elapsed_s[chosen],
            roll_rad=angles[0].astype(np.float32),
            pitch_rad=angles[1].astype(np.float32),
            yaw_rad=((angles[2] + np.pi) % (2.0 * np.pi) - np.pi).astype(np.float32),
            angular_rate_b_radps=_body_rates(angles, rates).astype(np.float32),
        )
        return _milliseconds(made)

    def _gnss(self, at: Array, elapsed_s: Array, height_m: Array, nearest: Any, fixes: Any) -> Rows:
        chosen, c, t = slice(None, None, TICKS["gnss"]), self._columns, self._time_s
        speed = (_filled(t, c["GndSpd"]) * KT_MPS)[nearest[chosen]]
        course = (_filled(t, c["TRK"]) % 360.0)[nearest[chosen]]
        error_m = fixes.error_m[chosen] if fixes is not None else 0.0
        made = table(
            Kind.GNSS,
            elapsed_s[chosen],
            latitude_deg=np.trunc(self._splines["lat"](at[chosen]) * 1e7) * 1e-7,
            longitude_deg=np.trunc(self._splines["lon"](at[chosen]) * 1e7) * 1e-7,
            altitude_amsl_m=np.trunc((height_m[chosen] + error_m) * 1000.0) * 1e-3,
            ground_speed_mps=np.trunc(100.0 * speed) * 0.01,
            course_rad=np.radians(np.trunc(100.0 * course) * 0.01),
            horizontal_sd_m=2.0,
            vertical_sd_m=fixes.vertical_sd_m[chosen] if fixes is not None else 0.5,
            hdop=fixes.hdop[chosen] if fixes is not None else 0.8,
            vdop=fixes.vdop[chosen] if fixes is not None else 1.3,
            fix_type=3,
            satellites=12,
        )
        made["time_us"] -= LATENCY_US
        return made


class _Noise:
    """Errors of the inertial sensor and the barometer: one stream of normal numbers, dealt out in
    the order in which the messages of a log are written."""

    def __init__(self, random: np.random.Generator, ticks: int, imu_every: int) -> None:
        accel_bias = random.normal(0.0, ACCEL_BIAS_MPS2, 3)
        gyro_bias = random.normal(0.0, GYRO_BIAS_RADPS, 3)
        tick = np.arange(ticks)
        has_imu = (tick % imu_every == 0).astype(int) if imu_every else np.zeros(ticks, int)
        has_pressure = (tick % TICKS["pressure"] == 0).astype(int)
        used = 6 * has_imu + has_pressure
        first = np.cumsum(used) - used
        drawn = random.standard_normal(int(used.sum()))
        imu = drawn[first[has_imu == 1][:, None] + np.arange(6)]
        self.accel: Array = accel_bias + ACCEL_SD_MPS2 * imu[:, :3]
        self.gyro: Array = gyro_bias + GYRO_SD_RADPS * imu[:, 3:]
        self.pressure: Array = drawn[(first + 6 * has_imu)[has_pressure == 1]]


def _read(path: Path) -> tuple[Array, dict[str, Array]]:
    """Seconds from 1 and the columns, NaN where unknown, of rows with an SBAS position."""
    csv.field_size_limit(10**8)
    with path.open(encoding="utf-8", errors="replace", newline="") as file:
        lines = list(csv.reader(file))
    at = next((i for i, line in enumerate(lines) if line and line[0].strip() == "Lcl Date"), None)
    if at is None:
        raise LogFormatError(f"{path}: no header line with 'Lcl Date'; give a G1000 CSV log")
    names = [name.strip() for name in lines[at]]
    body = [line for line in lines[at + 1 :] if len(line) >= len(names) - 3]
    columns = {name: _column(body, names.index(name)) for name in NUMBERS if name in names}
    unknown = np.full(len(body), np.nan)
    columns = {name: columns.get(name, unknown) for name in NUMBERS}
    if "AltB" not in names:
        columns["AltB"] = columns["AltInd"]
    sbas = np.ones(len(body), bool)
    if "GPSfix" in names:
        k = names.index("GPSfix")
        fix = [line[k].strip() if len(line) > k else "" for line in body]
        sbas = np.array([each == "3DDiff" for each in fix]) if "3DDiff" in fix else sbas
    known = sbas & np.isfinite(sum(columns[name] for name in (*NEEDED, "AltB")))
    if np.count_nonzero(known) < 120:
        raise LogFormatError(f"{path}: under two minutes with position, altitude and barometer")
    time_s = np.arange(len(body), dtype=np.float64)[known]
    return time_s - time_s[0] + 1.0, {name: value[known] for name, value in columns.items()}


def _column(body: list[list[str]], k: int) -> Array:
    texts = (line[k].strip() for line in body)
    return np.array([float(text) if text not in ("", "nan") else np.nan for text in texts])


def _splines(t: Array, columns: dict[str, Array]) -> dict[str, Any]:
    from scipy.interpolate import CubicSpline

    lat, lon = np.radians(columns["Latitude"]), np.radians(columns["Longitude"])
    qnh_hpa = columns["BaroA"] * INHG_HPA
    indicated_m = columns["AltB"] * FT_M
    hpa = (qnh_hpa**0.190263 - 8.417286e-5 * indicated_m) ** (1.0 / 0.190263)
    heading = columns["HDG"] if np.isfinite(columns["HDG"]).sum() > 10 else columns["TRK"]
    values = {
        "n": _smooth((lat - lat[0]) * EQUATORIAL_RADIUS_M),
        "e": _smooth((lon - lon[0]) * EQUATORIAL_RADIUS_M * np.cos(lat[0])),
        "h": _smooth(columns["AltMSL"] * FT_M),
        "p": hpa,
        "roll": _smooth(np.radians(_filled(t, columns["Roll"]))),
        "pitch": _smooth(np.radians(_filled(t, columns["Pitch"]))),
        "yaw": _smooth(np.unwrap(np.radians(_filled(t, heading)))),
        "lat": columns["Latitude"],
        "lon": columns["Longitude"],
    }
    return {name: CubicSpline(t, value) for name, value in values.items()}


def _filled(t: Array, values: Array, otherwise: float = 0.0) -> Array:
    """Unknown values between the known ones, linearly."""
    known = np.isfinite(values)
    if not known.any():
        return np.full_like(t, otherwise)
    return np.asarray(np.interp(t, t[known], values[known]))


def _smooth(values: Array) -> Array:
    """Weighted mean over five seconds: the log's resolution would be felt as acceleration."""
    weights = np.array([1.0, 2.0, 3.0, 2.0, 1.0]) / 9.0
    return np.convolve(np.pad(values, 2, "edge"), weights, "valid")


def _mat_nb(roll: Array, pitch: Array, yaw: Array) -> Array:
    """Body to NED, shape (n, 3, 3)."""
    sr, cr, sp, cp, sy, cy = (f(a) for a in (roll, pitch, yaw) for f in (np.sin, np.cos))
    rows = [
        [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
        [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
        [-sp, sr * cp, cr * cp],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _body_rates(angles: list[Array], rates: list[Array]) -> Array:
    """Angular rates of the body from Euler angles and their derivatives, shape (n, 3)."""
    (roll, pitch, _), (droll, dpitch, dyaw) = angles, rates
    return np.stack(
        [
            droll - dyaw * np.sin(pitch),
            dpitch * np.cos(roll) + dyaw * np.cos(pitch) * np.sin(roll),
            -dpitch * np.sin(roll) + dyaw * np.cos(pitch) * np.cos(roll),
        ],
        axis=1,
    )


def _counted(values: Array) -> Array:
    """Values as RAW_IMU holds them: 16-bit integers, truncated."""
    return np.trunc(np.clip(values, -32767.0, 32767.0))


def _milliseconds(made: Rows) -> Rows:
    """Stamps as messages with ``time_boot_ms`` have them."""
    made["time_us"] = made["time_us"] // 1000 * 1000
    return made

"""The records: sample rows, estimate rows, verdicts, and `SampleLog`.

A sample is one row of a NumPy structured array; its dtype is its kind. Every row has ``time_us``
(vehicle boot clock, when the quantity was true), ``arrival_us`` (host clock, when its bytes were
read) and ``instance`` (0 is the primary sensor). Unknown is NaN.

Rows travel as one-element arrays, which compiled steps index inside: passing a ``np.record`` to
compiled code costs ten times as much. `rows` makes them, and makes record arrays instead when
``NUMBA_DISABLE_JIT`` is set, so that ``sample[0].pressure_pa`` reads the same compiled and
uncompiled.
"""

import os
from collections.abc import Mapping
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[Any]
"""A one-dimensional structured array of one of the dtypes below."""

Record = Any
"""One row of `Rows`, or a record nested in one: what a component of an estimator's state is."""

MAX_INSTANCES = 4

COMPILED = os.environ.get("NUMBA_DISABLE_JIT", "0") in ("", "0")
"""Whether estimator steps are compiled (Numba's own switch, read without importing it)."""


class Packet(NamedTuple):
    """Bytes as they arrived: a datagram, a chunk of a serial stream, or one frame of a log."""

    time_us: int
    data: bytes


class Kind(IntEnum):
    """What a sample measures; also its index in `SampleLog.tables` and in an estimator's
    counters."""

    IMU = 0
    PRESSURE = 1
    GNSS = 2
    ATTITUDE = 3
    RANGE = 4
    AIR = 5
    STATUS = 6
    HOME = 7
    AIRSPEED = 8


class Verdict(IntEnum):
    """Result of a measurement in an estimator. A measurement never raises."""

    USED = 0
    GATED = 1
    """rejected by the estimator's gate: plausible alone, but inconsistent with the estimate"""
    STALE = 2
    """not newer than the last of its kind and instance, or older than the delay horizon"""
    INVALID = 3
    """not a measurement: NaN, out of physical range, without a fix, or known to be wrong"""
    IGNORED = 4
    """a kind of sample that this estimator does not use"""


class Suspicion(IntEnum):
    """Why the absolute value of a finite row in range is suspect (field ``suspect``)."""

    NONE = 0
    DATUM = 1
    """barometer and GNSS differ by more than weather can explain, and this sensor is the one that
    changed"""


class FaultySensor(IntEnum):
    """The sensor that an estimator attributes a fault to (field ``faulty``)."""

    NONE = 0
    BAROMETER = 1
    GNSS = 2
    IMU = 3


def _dtype(*fields: tuple[Any, ...]) -> np.dtype[Any]:
    head = [("time_us", "i8"), ("arrival_us", "i8"), ("instance", "i8")]
    return np.dtype(head + list(fields), align=True)


DTYPES: Mapping[Kind, np.dtype[Any]] = {
    Kind.IMU: _dtype(
        ("specific_force_b_mps2", "f8", (3,)),
        ("angular_rate_b_radps", "f8", (3,)),
    ),
    Kind.PRESSURE: _dtype(
        ("pressure_pa", "f8"),
        ("die_temperature_k", "f8"),  # of the sensor, 10-30 K above the air
        ("suspect", "i8"),
    ),
    Kind.GNSS: _dtype(
        ("latitude_deg", "f8"),
        ("longitude_deg", "f8"),
        ("altitude_amsl_m", "f8"),
        ("altitude_ellipsoid_m", "f8"),
        ("ground_speed_mps", "f8"),
        ("course_rad", "f8"),
        ("climb_mps", "f8"),
        ("horizontal_sd_m", "f8"),
        ("vertical_sd_m", "f8"),  # reported accuracy; NaN when none is reported
        ("hdop", "f8"),
        ("vdop", "f8"),
        ("fix_type", "i8"),  # MAVLink GPS_FIX_TYPE: 3 is 3D
        ("satellites", "i8"),  # -1 unknown
        ("suspect", "i8"),
        ("datum_sd_m", "f8"),  # constant part of the vertical spread: doubt in the datum, NaN none
    ),
    Kind.ATTITUDE: _dtype(
        ("roll_rad", "f8"),
        ("pitch_rad", "f8"),
        ("yaw_rad", "f8"),
        ("angular_rate_b_radps", "f8", (3,)),
    ),
    Kind.RANGE: _dtype(
        ("distance_m", "f8"),  # along the sensor's axis
        ("downward", "i8"),  # 1 when it looks down
    ),
    Kind.AIR: _dtype(
        ("air_temperature_k", "f8"),
        ("qnh_pa", "f8"),
        ("field_elevation_m", "f8"),  # of the ground that the vehicle rests on
        ("qnh_elevation_m", "f8"),  # where the QNH was measured
        ("qnh_sd_pa", "f8"),  # of a QNH that is measured now; NaN for one that was told
    ),
    Kind.STATUS: _dtype(
        ("armed", "i8"),  # 1, 0, -1 unknown
        ("landed", "i8"),  # 1 on ground, 0 in air, -1 unknown
        ("reboot", "i8"),  # 1 when the vehicle's clock restarted: the estimator starts anew
    ),
    Kind.HOME: _dtype(
        ("latitude_deg", "f8"),
        ("longitude_deg", "f8"),
        ("altitude_amsl_m", "f8"),
    ),
    Kind.AIRSPEED: _dtype(
        ("airspeed_mps", "f8"),  # calibrated: what the dynamic pressure corresponds to at sea level
    ),
}

ESTIMATE = np.dtype(
    [
        ("time_us", "i8"),
        ("altitude_amsl_m", "f8"),
        ("climb_mps", "f8"),
        ("altitude_sd_m", "f8"),
        ("climb_sd_mps", "f8"),
        (
            "baro_offset_m",
            "f8",
        ),  # altitude_amsl - geometric pressure altitude: what the weather does
        ("innovation_m", "f8"),  # of the last GNSS height
        ("height_above_takeoff_m", "f8"),
        ("baro_rate_mps", "f8"),  # drift of the barometer's error at constant height
        ("baro_scale", "f8"),  # change of the barometer's error with height
        ("gnss_offset_m", "f8"),  # slow error of the GNSS height
        ("qnh_pa", "f8"),  # altimeter setting with which an altimeter here indicates altitude_amsl
        ("qnh_sd_pa", "f8"),
        ("protection_level_m", "f8"),  # exceeded only at the configured integrity risk
        ("alert_limit_m", "f8"),  # protection level above which the height must not be published
        ("drift_probabilities", "f8", (3,)),  # of calm, fair, stormy weather
        ("faulty", "i8"),  # a `FaultySensor`
        ("faulty_since_us", "i8"),
        ("fault_probabilities", "f8", (3,)),  # of barometer, GNSS, IMU being wrong
    ],
    align=True,
)

HEIGHT = np.dtype([("time_us", "i8"), ("altitude_amsl_m", "f8"), ("climb_mps", "f8")], align=True)
"""Truth (SIM_STATE) and the autopilot's own estimate (GLOBAL_POSITION_INT), for comparison only; no
estimator receives them."""

ORDER = np.dtype([("kind", "i8"), ("row", "i8")], align=True)


def rows(dtype: np.dtype[Any], count: int = 1) -> Rows:
    """`count` rows of `dtype`: floats NaN, integers 0."""
    array = np.zeros(count, dtype)
    _unknown(array)
    return readable(array)


def _unknown(array: Rows) -> None:
    """Set every float to NaN, those of nested records included."""
    for name, (field, *_) in (array.dtype.fields or {}).items():
        if field.base.kind == "f":
            array[name] = np.nan
        elif field.base.kind == "V":
            _unknown(array[name])


def readable(array: Rows) -> Rows:
    """`array` in the form the steps expect: plain when compiled, a record array when not."""
    return array if COMPILED else array.view(np.recarray)


def sample(kind: Kind, time_us: int, **values: Any) -> Rows:
    """One sample row, shape (1,), with the given fields set and the others unknown."""
    row = rows(DTYPES[kind])
    row["time_us"] = time_us
    row["arrival_us"] = values.pop("arrival_us", time_us)
    for name, value in values.items():
        row[name] = value
    return row


class Tables(NamedTuple):
    """Input of a compiled `run`: the order of arrival, and one table for each kind in the order of
    `Kind`."""

    order: Rows
    imu: Rows
    pressure: Rows
    gnss: Rows
    attitude: Rows
    range: Rows
    air: Rows
    status: Rows
    home: Rows
    airspeed: Rows


class _Column:
    """A structured array that grows by doubling."""

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self.array: Rows = np.zeros(64, dtype)
        self.size = 0

    @classmethod
    def of(cls, array: Rows) -> "_Column":
        """The column that holds `array`, which it takes over."""
        column = cls(array.dtype)
        column.array, column.size = array, array.size
        return column

    def append(self, row: Any) -> int:
        if self.size == self.array.size:
            more = np.zeros(max(64, self.size), self.array.dtype)
            self.array = np.concatenate([self.array, more])
        self.array[self.size] = row
        self.size += 1
        return self.size - 1

    def extend(self, rows: Rows) -> int:
        """Add many; the place of the first."""
        first, needed = self.size, self.size + rows.size
        if needed > self.array.size:
            more = np.zeros(max(needed - self.array.size, self.size), self.array.dtype)
            self.array = np.concatenate([self.array, more])
        self.array[first:needed] = rows
        self.size = needed
        return first

    def view(self) -> Rows:
        return readable(self.array[: self.size])


class SampleLog:
    """Samples in tables, with the order in which they arrived. A live system cannot sort, so
    neither does a log."""

    def __init__(self) -> None:
        self._columns = {kind: _Column(dtype) for kind, dtype in DTYPES.items()}
        self._order = _Column(ORDER)
        self._truth = _Column(HEIGHT)
        self._autopilot = _Column(HEIGHT)

    @classmethod
    def of_tables(cls, tables: Mapping[Kind, Rows], truth: Rows | None = None) -> "SampleLog":
        """A log of whole tables, rows of ``DTYPES[kind]`` each in order of arrival.

        Rows of different kinds are ordered by ``arrival_us``; of rows that arrive at the same time
        those of the kind that comes first in `Kind` come first. `truth` has rows of `HEIGHT`.
        """
        log = cls()
        sizes = [tables[kind].size if kind in tables else 0 for kind in Kind]
        kinds = np.repeat(np.array([int(kind) for kind in Kind]), sizes)
        arrivals = np.zeros(kinds.size, np.int64)
        order = np.zeros(kinds.size, ORDER)
        for kind, size in zip(Kind, sizes, strict=True):
            if size:
                log._columns[kind] = _Column.of(np.asarray(tables[kind]))
                arrivals[kinds == kind] = tables[kind]["arrival_us"]
                order["row"][kinds == kind] = np.arange(size)
        order["kind"] = kinds
        log._order = _Column.of(order[np.lexsort((kinds, arrivals))])
        if truth is not None:
            log._truth = _Column.of(np.asarray(truth))
        return log

    def append(self, kind: Kind, row: Rows) -> None:
        """Add a one-element array of ``DTYPES[kind]``."""
        self._order.append((kind, self._columns[kind].append(row[0])))

    def extend(self, tables: Tables) -> None:
        """Add the samples of other tables, in their order."""
        kinds, places = np.asarray(tables.order["kind"]), np.asarray(tables.order["row"])
        order = np.zeros(kinds.size, ORDER)
        order["kind"] = kinds
        for kind in np.unique(kinds).tolist():
            chosen = kinds == kind
            first = self._columns[Kind(kind)].extend(np.asarray(tables[1 + kind])[places[chosen]])
            order["row"][chosen] = first + np.arange(int(chosen.sum()))
        self._order.extend(order)

    def extend_truth(self, heights: Rows) -> None:
        """Add HEIGHT rows of a simulator's truth."""
        self._truth.extend(heights)

    def extend_autopilot(self, heights: Rows) -> None:
        """Add HEIGHT rows of the autopilot's own estimate."""
        self._autopilot.extend(heights)

    def append_truth(self, height: tuple[int, float, float]) -> None:
        """Add (time_us, altitude_amsl_m, climb_mps) of a simulator's truth."""
        self._truth.append(height)

    def append_autopilot(self, height: tuple[int, float, float]) -> None:
        """Add (time_us, altitude_amsl_m, climb_mps) of the autopilot's own estimate."""
        self._autopilot.append(height)

    @property
    def truth(self) -> Rows:
        return self._truth.view()

    @property
    def autopilot(self) -> Rows:
        return self._autopilot.view()

    @property
    def tables(self) -> Tables:
        return Tables(self._order.view(), *(self._columns[kind].view() for kind in Kind))

    @property
    def first_us(self) -> int:
        """Time of the first sample in order of arrival; 0 when there is none."""
        if not len(self):
            return 0
        first = self._order.array[0]
        return int(self._columns[Kind(int(first["kind"]))].array[int(first["row"])]["time_us"])

    def __len__(self) -> int:
        return self._order.size

    def __getitem__(self, kind: Kind) -> Rows:
        return self._columns[kind].view()

"""ArduPlane logs with two RTK receivers (NumPy archive, arrays ``MESSAGE+instance.FIELD`` and
``.t``): everything is measured, the truth is the second receiver.

The first receiver's heights are the GNSS (fix type 6, accuracy of centimetres), or the truth with
an error laid on, as a cheap receiver's. Both receivers' stamps are those of the log and late alike.
"""

import zipfile
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from companion.errors import LogFormatError
from companion.samples import Kind, Rows, SampleLog
from sim.constants import ZERO_CELSIUS_K
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

LATENCY_US = 120_000
"""latency that the intake subtracts from a GNSS time stamp, and so from that of the truth"""
IMU_MEAN_S = 0.02
"""a slow stream has means over this time, as an autopilot's filter"""
NEEDED = ("GPS0.Alt", "GPS1.Alt", "GPA0.VAcc", "BARO0.Press", "IMU0.AccX", "ATT0.Roll")


class Carbonix(Recording):
    """One such archive."""

    own_gnss: ClassVar[bool] = True

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        with np.load(path) as archive:
            self._arrays = {name: archive[name] for name in archive.files}
        starts = [self._arrays[f"{name}.t"] for name in NEEDED]
        if any(each.size < 100 for each in starts):
            raise LogFormatError(f"{path}: a receiver, barometer or IMU has under 100 samples")
        self._start_ms = float(max(each[0] for each in starts))
        self.duration_s = (float(min(each[-1] for each in starts)) - self._start_ms) * 1e-3

    @classmethod
    def recognises(cls, path: Path) -> bool:
        if path.suffix.lower() != ".npz" or not zipfile.is_zipfile(path):
            return False
        with np.load(path) as archive:
            return set(NEEDED) <= set(archive.files)

    def samples(self, plan: Plan, error: GnssError | None) -> SampleLog:
        truth_s, truth_m = self._of("GPS1.Alt")
        elapsed_s, own_m = self._of("GPS0.Alt")
        tables: dict[Kind, Rows] = {
            Kind.STATUS: status_rows(self.duration_s),
            Kind.PRESSURE: self._pressure(),
            Kind.GNSS: self._gnss(elapsed_s, own_m, None)
            if error is None
            else self._gnss(elapsed_s, np.interp(elapsed_s, truth_s, truth_m), (error, plan.seed)),
        }
        if plan.imu_hz:
            tables[Kind.IMU] = self._imu(plan.imu_hz)
        if plan.attitude:
            tables[Kind.ATTITUDE] = self._attitude()
        if plan.field_elevation:
            tables[Kind.AIR] = elevation_row(1.0, float(truth_m[0]), plan.seed)
        climb = -np.interp(truth_s, *self._of("GPS1.VZ"))
        truth = truth_rows(truth_s - LATENCY_US * 1e-6, truth_m, climb)
        return SampleLog.of_tables(tables, truth)

    def _of(self, name: str) -> tuple[Array, Array]:
        """Seconds since boot, 1 at the start, and values of an array, within the common time."""
        time_s = (self._arrays[f"{name}.t"] - self._start_ms) * 1e-3 + 1.0
        inside = (time_s >= 1.0) & (time_s <= self.duration_s + 1.0)
        return time_s[inside], self._arrays[name][inside].astype(np.float64)

    def _pressure(self) -> Rows:
        elapsed_s, pressure_pa = self._of("BARO0.Press")
        die_k = np.interp(elapsed_s, *self._of("BARO0.Temp")) + ZERO_CELSIUS_K
        return table(Kind.PRESSURE, elapsed_s, pressure_pa=pressure_pa, die_temperature_k=die_k)

    def _gnss(
        self, elapsed_s: Array, height_m: Array, laid_on: tuple[GnssError, int] | None
    ) -> Rows:
        made = table(
            Kind.GNSS,
            elapsed_s,
            latitude_deg=self._of("GPS0.Lat")[1],
            longitude_deg=self._of("GPS0.Lng")[1],
            altitude_amsl_m=height_m,
            ground_speed_mps=self._of("GPS0.Spd")[1],
            course_rad=np.radians(self._of("GPS0.GCrs")[1]),
            hdop=self._of("GPS0.HDop")[1],
            fix_type=self._of("GPS0.Status")[1].astype(np.int64),
            satellites=self._of("GPS0.NSats")[1].astype(np.int64),
        )
        if laid_on is None:
            made["vertical_sd_m"] = np.interp(elapsed_s, *self._of("GPA0.VAcc"))
            made["horizontal_sd_m"] = np.interp(elapsed_s, *self._of("GPA0.HAcc"))
        else:
            error, seed = laid_on
            grid_s = np.arange(0.0, self.duration_s + 1.0, STEP_S)
            said = error.at(grid_s, np.random.default_rng(seed))
            at = np.clip(((elapsed_s - 1.0) / STEP_S).astype(np.int64), 0, grid_s.size - 1)
            made["altitude_amsl_m"] += said.error_m[at]
            made["vertical_sd_m"], made["vdop"] = said.vertical_sd_m[at], said.vdop[at]
            made["hdop"], made["fix_type"], made["horizontal_sd_m"] = said.hdop[at], 3, 2.0
        made["time_us"] -= LATENCY_US
        return made

    def _imu(self, rate_hz: int) -> Rows:
        names = [f"IMU0.{field}{axis}" for field in ("Acc", "Gyr") for axis in "XYZ"]
        time_s = self._of(names[0])[0]
        values = np.stack([self._of(name)[1] for name in names], axis=1)
        sums = np.concatenate([np.zeros((1, 6)), np.cumsum(values, axis=0)])
        wanted_s = np.arange(time_s[0] + IMU_MEAN_S, time_s[-1], 1.0 / rate_hz)
        stop = np.searchsorted(time_s, wanted_s, "right")
        start = np.minimum(np.searchsorted(time_s, wanted_s - IMU_MEAN_S, "right"), stop - 1)
        mean = (sums[stop] - sums[start]) / (stop - start)[:, None]
        return table(
            Kind.IMU,
            wanted_s,
            specific_force_b_mps2=mean[:, :3],
            angular_rate_b_radps=mean[:, 3:],
        )

    def _attitude(self) -> Rows:
        elapsed_s = self._of("ATT0.Roll")[0]
        angles = {
            f"{name.lower()}_rad": np.radians(self._of(f"ATT0.{name}")[1])
            for name in ("Roll", "Pitch", "Yaw")
        }
        angles["yaw_rad"] = (angles["yaw_rad"] + np.pi) % (2.0 * np.pi) - np.pi
        return table(Kind.ATTITUDE, elapsed_s, **angles, angular_rate_b_radps=0.0)

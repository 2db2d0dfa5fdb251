"""Paper R, section VI: five minutes without GNSS, with the barometer, without, in weather."""

import math

import numpy as np
from numpy.typing import NDArray

from companion.estimators.baro_gnss_ins import METHOD
from companion.estimators.baro_gnss_ins.settings import BaroGnssInsSettings
from companion.estimators.baro_gnss_ins.strapdown import transition
from companion.estimators.method import run_log
from companion.plots.style import BOUND, FUSED, GNSS, INERTIAL
from companion.samples import Kind, Rows, SampleLog, sample
from sim.studies.page import generators, spread
from sim.studies.papers.baro_gnss_ins.formulas import SECOND_US, pressures_pa
from sim.studies.papers.page import Page, Row, below, holds

Array = NDArray[np.float64]
IMU_HZ, PRESSURE_HZ, FIX_HZ, FLIGHT_S, LOST_S, FOUND_S = 25, 5, 1, 540, 150, 450
SPEED_MPS, HEADING_RAD, GRAVITY_MPS2 = 40.0, 0.7, 9.8066
METRES_PER_DEGREE = 111_200.0
LEGS = ((30.0, 4.0), (130.0, -4.0), (200.0, 3.0), (300.0, -6.0), (400.0, 3.0))
"""(start_s, change of climb, m/s), each over RAMP_S"""
RAMP_S = 4.0
DRIFTS_HPA_PER_H, DRIFT_SEEDS, M_PER_HPA = (11.0, 26.0), 20, 8.3
"""Weather in the outage: b walks 18 m an hour in the filter, 2 hPa; fronts reach 11, storms 26."""


def motion(time_s: Array) -> tuple[Array, Array, Array]:
    """True height, climb and vertical acceleration."""
    height, climb, acceleration = (
        np.full_like(time_s, 400.0),
        np.zeros_like(time_s),
        np.zeros_like(time_s),
    )
    for start_s, change in LEGS:
        x = np.clip((time_s - start_s) / RAMP_S, 0.0, 1.0)
        after_s = np.maximum(0.0, time_s - start_s - RAMP_S)
        height += change * (RAMP_S * (x**3 - 0.5 * x**4) + after_s)
        climb += change * (3 * x**2 - 2 * x**3)
        acceleration += change * 6 * (x - x**2) / RAMP_S
    return height, climb, acceleration


def wander(generator: np.random.Generator, count: int, sd: float, time_constant_s: float) -> Array:
    """First-order Gauss-Markov process, a value a second."""
    keep = math.exp(-1.0 / time_constant_s)
    values, steps = np.empty(count), sd * math.sqrt(1 - keep**2) * generator.standard_normal(count)
    values[0] = sd * generator.standard_normal()
    for i in range(1, count):
        values[i] = keep * values[i - 1] + steps[i]
    return values


class Outage:
    """An aeroplane with GNSS until 150 s and from 450 s on; the same flight with its barometer and
    without."""

    def __init__(
        self,
        names: tuple[str, ...] = ("with", "without"),
        settings: BaroGnssInsSettings | None = None,
    ) -> None:
        self.settings = settings
        self.logs = {name: SampleLog() for name in names}
        self.fixes_s: list[float] = []
        for tick in range(FLIGHT_S * IMU_HZ):
            time_us = SECOND_US + tick * SECOND_US // IMU_HZ
            for name, log in self.logs.items():
                log.append(Kind.IMU, sample(Kind.IMU, time_us))
                if tick % (IMU_HZ // PRESSURE_HZ) == 0 and name == "with":
                    log.append(Kind.PRESSURE, sample(Kind.PRESSURE, time_us, suspect=0))
            second = tick / IMU_HZ
            if tick % (IMU_HZ // FIX_HZ) == 0 and not LOST_S <= second < FOUND_S:
                self.fixes_s.append(second)
                for log in self.logs.values():
                    log.append(
                        Kind.GNSS,
                        sample(Kind.GNSS, time_us, fix_type=3, vertical_sd_m=math.sqrt(18.0)),
                    )
        self.seconds = np.arange(0.0, FLIGHT_S, 2.0)
        self.squares = {name: np.zeros(self.seconds.size) for name in self.logs}
        self.worst_m: dict[str, list[float]] = {name: [] for name in self.logs}
        self.good_m: dict[str, list[float]] = {name: [] for name in self.logs}
        self.share: dict[str, list[float]] = {name: [] for name in self.logs}
        self.runs = 0

    def fly(self, generator: np.random.Generator, weather_mps: float = 0.0) -> None:
        """One draw of all sensor errors through both logs; the barometer drifts with the
        weather."""
        self.runs += 1
        imu_s = np.arange(FLIGHT_S * IMU_HZ) / IMU_HZ
        force, rate = self._inertial(
            imu_s - 0.5 / IMU_HZ, generator
        )  # a sample is the mean up to its time
        height, _, _ = motion(np.arange(FLIGHT_S * PRESSURE_HZ) / PRESSURE_HZ)
        b_m, s = 50.0 * generator.standard_normal(), 0.03 * generator.standard_normal()
        pressure = pressures_pa(
            (height - b_m - weather_mps * np.arange(height.size) / PRESSURE_HZ) / (1.0 + s)
            + 0.3 * generator.standard_normal(height.size)
        )
        slow_m = wander(generator, FLIGHT_S, 3.0, 300.0)
        fixes = self._fixes(slow_m, generator)
        for name, log in self.logs.items():
            log[Kind.IMU]["specific_force_b_mps2"], log[Kind.IMU]["angular_rate_b_radps"] = (
                force,
                rate,
            )
            if name == "with":
                log[Kind.PRESSURE]["pressure_pa"] = pressure
            for field, values in fixes.items():
                log[Kind.GNSS][field] = values
            self._note(name, run_log(METHOD, log, self.settings)[0], slow_m)

    def _inertial(self, time_s: Array, generator: np.random.Generator) -> tuple[Array, Array]:
        _, climb, acceleration = motion(time_s)
        pitch, support = np.arctan2(climb, SPEED_MPS), GRAVITY_MPS2 + acceleration
        force = np.stack(
            [np.sin(pitch) * support, np.zeros_like(pitch), -np.cos(pitch) * support], axis=1
        )
        rate = np.zeros_like(force)
        rate[:, 1] = acceleration * SPEED_MPS / (SPEED_MPS**2 + climb**2)
        root_hz = math.sqrt(IMU_HZ)
        force += 0.1 * generator.standard_normal(3) + 0.02 * root_hz * generator.standard_normal(
            force.shape
        )
        rate += 0.005 * generator.standard_normal(3) + 5e-4 * root_hz * generator.standard_normal(
            rate.shape
        )
        return force, rate

    def _fixes(self, slow_m: Array, generator: np.random.Generator) -> dict[str, Array]:
        seconds = np.array(self.fixes_s)
        slow = slow_m[seconds.astype(int)]
        along_m = SPEED_MPS * seconds
        return {
            "altitude_amsl_m": motion(seconds)[0]
            + slow
            + 3.0 * generator.standard_normal(seconds.size),
            "latitude_deg": 45.0 + along_m * math.cos(HEADING_RAD) / METRES_PER_DEGREE,
            "longitude_deg": 8.0
            + along_m * math.sin(HEADING_RAD) / METRES_PER_DEGREE / math.cos(math.pi / 4),
            "ground_speed_mps": SPEED_MPS + 0.1 * generator.standard_normal(seconds.size),
            "course_rad": HEADING_RAD + 0.003 * generator.standard_normal(seconds.size),
            "horizontal_sd_m": np.full(seconds.size, 2.0),
        }

    def _note(self, name: str, estimates: Rows, slow_m: Array) -> None:
        known = estimates[np.isfinite(estimates["altitude_amsl_m"])]
        elapsed_s = (known["time_us"] - SECOND_US) * 1e-6
        latest = np.searchsorted(elapsed_s, self.seconds, side="right") - 1
        rows = known[np.maximum(latest, 0)]
        error = rows["altitude_amsl_m"] - motion((rows["time_us"] - SECOND_US) * 1e-6)[0]
        lost = (self.seconds >= LOST_S) & (self.seconds < FOUND_S)
        good = (self.seconds >= 60.0) & (self.seconds < LOST_S)
        self.squares[name] += error**2
        self.worst_m[name].append(float(np.abs(error[lost]).max()))
        self.good_m[name].append(
            float(np.sqrt(np.mean((error - slow_m[self.seconds.astype(int)])[good] ** 2)))
        )
        self.share[name].append(float(np.mean(error[lost] ** 2 / rows["altitude_sd_m"][lost] ** 2)))


def outage_rows(outage: Outage) -> list[Row]:
    with_baro, without = spread(outage.worst_m["with"]), spread(outage.worst_m["without"])
    good, bare = spread(outage.good_m["with"]), spread(outage.good_m["without"])
    pole = vertical_pole()
    return [
        holds(
            "the INS's vertical channel is unstable: largest pole, 1/s",
            below(0.0, pole),
            pole,
            printed="unstable",
            unit="1/s",
            where="sec. VI",
            note="of the estimator's error model: gravity falls with height, e-fold in "
            f"{1.0 / pole:.0f} s",
        ),
        holds(
            "the barometer stabilises it: largest error in the outage",
            below(with_baro.mean, 0.1 * without.mean),
            f"{with_baro}, without it {without}",
            unit="m",
            where="sec. VI",
            note="with it ours stops integrating after a minute without GNSS velocity; without "
            "it, it must go on",
        ),
        holds(
            "used continuously, it also helps beside GNSS (RMS before the outage, from truth plus "
            "slow GNSS error)",
            below(good.mean, bare.mean),
            f"{good}, without it {bare}",
            unit="m",
            where="sec. VI",
            note="the receiver's slow error itself (3 m) is followed by both",
        ),
    ]


STORM_WALK_M_RTS = DRIFTS_HPA_PER_H[-1] * M_PER_HPA / 3600.0 * math.sqrt(FOUND_S - LOST_S)
"""Random walk of b whose spread after the outage is what the fastest drift adds in it."""


def in_weather(seeds: int, hpa_per_h: float, walk_m_rts: float | None = None) -> Outage:
    """Flights with the barometer through a steady drift; with another walk of b if given."""
    walk = {} if walk_m_rts is None else {"baro_walk_m_rts": walk_m_rts}
    outage = Outage(("with",), BaroGnssInsSettings(**walk))
    for generator in generators("R", min(seeds, DRIFT_SEEDS)):
        outage.fly(generator, hpa_per_h * M_PER_HPA / 3600.0)
    return outage


def storm_row(stormy: Outage) -> Row:
    """What follows from the fastest drift: the setting that makes the spread honest."""
    nees, worst = spread(stormy.share["with"]), spread(stormy.worst_m["with"])
    return holds(
        f"the same, weather {DRIFTS_HPA_PER_H[-1]:g} hPa/h",
        below(nees.mean, 2.0),
        nees,
        reading=f"`baro_walk_m_rts` {STORM_WALK_M_RTS:.2f}, which reaches this drift in the outage "
        "(default 0.3: 18 m in an hour)",
        note=f"largest error {worst} m: a walk widens the spread, it does not follow a drift "
        "that nothing measures",
    )


def drift_rows(drifting: dict[float, Outage]) -> list[Row]:
    """Whether the reported spread is honest, by the drift of the weather."""
    rows = []
    for hpa_per_h, outage in drifting.items():
        nees, worst = spread(outage.share["with"]), spread(outage.worst_m["with"])
        row = holds(
            f"the spread reported in the outage is honest, weather {hpa_per_h:g} hPa/h: error "
            "squared over variance",
            below(nees.mean, 2.0),
            nees,
            note=f"1 is exact, less is cautious; errors are {math.sqrt(nees.mean):.1f} times the "
            f"reported spread; largest error {worst} m",
        )
        rows.append(row)
    return rows


def vertical_pole() -> float:
    """Largest real part of the poles of height and climb in the estimator's error model, 1/s."""
    step_s = 0.1
    phi, mat = np.eye(15), np.zeros((4, 3))
    mat[:3] = np.eye(3)
    transition(phi, mat, step_s)
    kept = np.ix_([2, 5], [2, 5])
    return float(np.log(np.abs(np.linalg.eigvals(phi[kept])).max()) / step_s)


def draw_outage(page: Page, outage: Outage) -> None:
    caption = "RMS height error over the seeds. GNSS is lost between the dashed lines."
    with page.figure("outage", caption) as axes:
        for name, colour, label in (
            ("without", INERTIAL, "GNSS/INS"),
            ("with", FUSED, "with the barometer"),
        ):
            axes[0].plot(
                outage.seconds,
                np.sqrt(outage.squares[name] / outage.runs),
                color=colour,
                label=label,
            )
        for second in (LOST_S, FOUND_S):
            axes[0].axvline(second, color=BOUND, linestyle="--", linewidth=0.8)
        axes[0].axhline(
            math.sqrt(18.0), color=GNSS, linewidth=0.8, linestyle=":", label="a single fix"
        )
        axes[0].set(yscale="log", ylim=(0.5, 3000), xlabel="time (s)", title="RMS error (m)")
        axes[0].legend()

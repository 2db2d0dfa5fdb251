"""Paper R: Roysdon, Farrell, against `companion.estimators.baro_gnss_ins.steps`.

The note prints formulas and recommendations, no simulation. Its formulas are compared with the
standard atmosphere; its recommendations are tried on descents, climbs and an inertial flight that
are made here:

- the spike gate on a descent of 10 m/s with 1 Pa of noise and 1 % of spikes;
- barometer bias and scale factor (15)-(16) in level flight and in a climb, 3 m GNSS and 1 m
  barometer once a second;
- a flight with a five-minute GNSS outage, with and without the barometer.

Whatever the estimator has an input for goes through it as rows that a vehicle would send
(`run_log`).
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.estimators.baro_gnss_ins import METHOD
from companion.estimators.baro_gnss_ins.altimetry import (
    INCH_OF_MERCURY_PA,
    cubic_altitude_m,
    kollsman_altitude_m,
    kollsman_slope_mppa,
)
from companion.estimators.baro_gnss_ins.barometer import correct_baro
from companion.estimators.baro_gnss_ins.filter import N
from companion.estimators.baro_gnss_ins.settings import BaroGnssInsSettings
from companion.estimators.baro_gnss_ins.strapdown import transition
from companion.estimators.method import run_log
from companion.kernels.atmosphere import (
    baro_altitude_m,
    geopotential_m,
    pressure_altitude_m,
    standard_pressure_pa,
)
from companion.samples import Kind, Rows, SampleLog, Verdict, sample
from sim.studies.page import BARO, BOUND, FUSED, GNSS, INERTIAL, OTHER, Spread, generators, spread
from sim.studies.papers import Progress
from sim.studies.papers.page import Page, Row, at_most, below, compare, holds, near

Array = NDArray[np.float64]

P0_PA, P_3KM_PA = 101_325.0, 70_108.526
SECOND_US = 1_000_000

GATE_PA, SINK_MPS, SPIKE_SHARE, SPIKE_PA, NOISE_PA = 5.0, 10.0, 0.01, 60.0, 1.0
GATE_RATES_HZ = (1, 10, 20)

B_M, S, BARO_SD_M, GNSS_SD_M = 25.0, 0.03, 1.0, 3.0
LEVEL_M = np.full(420, 800.0)
CLIMB_M = np.concatenate([np.full(60, 100.0), np.arange(100.0, 1600.0, 5.0), np.full(60, 1600.0)])
CONSTANT = BaroGnssInsSettings(
    baro_walk_m_rts=0.0,
    baro_scale_walk_rts=0.0,
    baro_scale_sd_ratio=0.1,
    gnss_correlation_s=0.0,
    gnss_correlated_ratio=0.0,
)
"""The filter told what is true here: constant b and s, white GNSS errors."""


def standard_pressures_pa(heights_m: Array) -> Array:
    """Pressure of the standard atmosphere at geopotential heights."""
    return np.array([standard_pressure_pa(height) for height in heights_m.tolist()])


def pressures_pa(geometric_m: Array) -> Array:
    """Pressure at which a barometer reads these (geometric) heights."""
    return np.array(
        [standard_pressure_pa(geopotential_m(height)) for height in geometric_m.tolist()]
    )


def reproduce(seeds: int, out: Path, progress: Progress) -> Page:
    """The page of paper R."""
    page = Page("R", seeds, out)
    page.text(
        "A technical note without a simulation of its own: formulas for pressure altitude, a "
        "rejection of spikes, and the barometer as a measurement of a GNSS/INS extended Kalman "
        "filter, with a bias and a scale factor. The formulas are held against the standard "
        "atmosphere, the rest is tried on flights made for it. Receiver clock bias and drift, two "
        "of the note's twenty states, need pseudoranges and are absent from ours."
    )
    page.table("Pressure, density, altitude (sections II to IV)", _altitude_rows())
    page.table("The cubic (12) against the standard atmosphere", _cubic_rows())
    _draw_cubic(page)
    page.table("Kollsman correction (section V)", _kollsman_rows())
    progress(0.02, "spike gate")
    descents = [Descents.of(rate_hz, min(seeds, 20)) for rate_hz in GATE_RATES_HZ]
    page.table(
        "Spikes (section IV): a descent of 10 m/s",
        _gate_rows(descents),
        tuple(f"{rate_hz} Hz" for rate_hz in GATE_RATES_HZ),
    )
    _draw_gate(page)
    level, climb = Profile(LEVEL_M), Profile(CLIMB_M)
    for done, generator in enumerate(generators("R", seeds), start=1):
        level.fly(generator)
        climb.fly(generator)
        progress(0.05 + 0.25 * done / seeds, "bias and scale factor")
    page.table("Bias and scale factor (15), (16)", _state_rows(level, climb))
    _draw_states(page, level, climb)
    outage = Outage()
    for done, generator in enumerate(generators("R", seeds), start=1):
        outage.fly(generator)
        progress(0.3 + 0.55 * done / seeds, "GNSS outage")
    drifting = {0.0: outage}
    for hpa_per_h in DRIFTS_HPA_PER_H:
        progress(0.85, f"weather, {hpa_per_h:g} hPa/h")
        drifting[hpa_per_h] = Outage(("with",))
        for generator in generators("R", min(seeds, DRIFT_SEEDS)):
            drifting[hpa_per_h].fly(generator, hpa_per_h * M_PER_HPA / 3600.0)
    page.table(
        "The vertical channel (section VI): five minutes without GNSS",
        _outage_rows(outage) + _drift_rows(drifting),
    )
    _draw_outage(page, outage)
    return page


# Sections II to V: formulas


def _altitude_rows() -> list[Row]:
    density = P0_PA / (287.05 * 288.15)
    at_1km = standard_pressure_pa(1000.0)
    linear_m = (at_1km - P0_PA) / (density * 9.81)
    return [
        compare(
            "59 °F in kelvin",
            288.15,
            5.0 / 9.0 * (59.0 - 32.0) + 273.15,
            0.005,
            unit="K",
            where="(10)",
        ),
        compare(
            "pascals in an inch of mercury",
            3385.0,
            INCH_OF_MERCURY_PA,
            0.5,
            unit="Pa",
            where="(11)",
        ),
        holds(
            "29.92 inches are 101 325 Pa",
            near(3385.0 * 29.92, P0_PA, 10.0),
            3385.0 * 29.92,
            printed=P0_PA,
            unit="Pa",
            where="(11), (13)",
            note="with the printed factor; 3.8 m of altitude",
        ),
        compare(
            "height above ground at 1000 m",
            1000.0,
            linear_m,
            10.0,
            unit="m",
            where="(8)",
            note="the sign is wrong, (p_ground - p) is meant",
        ),
        compare(
            "the same with the other sign",
            1000.0,
            -linear_m,
            10.0,
            unit="m",
            where="(8)",
            note="density falls with height",
        ),
        compare("density at sea level", 1.225, density, 5e-4, unit="kg/m³", where="(9)"),
    ]


def _cubic_rows() -> list[Row]:
    rows = [
        compare(
            f"at the pressure of {height:.0f} m",
            height,
            cubic_altitude_m(standard_pressure_pa(height)),
            within=10.0,
            unit="m",
            where="(12)",
        )
        for height in (-1000.0, 0.0, 1000.0, 3000.0, 5000.0, 8000.0, 11_000.0, 15_000.0, 18_288.0)
    ]
    cubic = (cubic_altitude_m(P0_PA + 1.0) - cubic_altitude_m(P0_PA - 1.0)) / 2.0
    closed = (pressure_altitude_m(P0_PA + 1.0) - pressure_altitude_m(P0_PA - 1.0)) / 2.0
    note = (
        f"{100 * (cubic / closed - 1):.0f} % too steep: a climb of 5 m/s shows as "
        f"{5 * cubic / closed:.1f}"
    )
    return [
        *rows,
        compare("dh/dp at sea level", closed, cubic, 0.001, unit="m/Pa", where="(12)", note=note),
    ]


def _kollsman_rows() -> list[Row]:
    measured_pa = standard_pressure_pa(500.0) * 100_000.0 / P0_PA
    at_3km_pa = standard_pressure_pa(3000.0) * 100_000.0 / P0_PA
    high_m = pressure_altitude_m(at_3km_pa)
    with_sea_level_slope = high_m + kollsman_slope_mppa(P0_PA, P0_PA) * (100_000.0 - P0_PA)
    return [
        holds(
            "no correction on a standard day",
            near(kollsman_altitude_m(measured_pa, P0_PA), pressure_altitude_m(measured_pa), 0.0),
            0.0,
            printed=0.0,
            unit="m",
            where="(13)",
        ),
        Row(
            "dh/dp_sl at sea level",
            None,
            kollsman_slope_mppa(P0_PA, P0_PA),
            unit="m/Pa",
            where="(13)",
            note="positive: more pressure at sea level, more altitude for the same pressure",
        ),
        Row(
            "dh/dp_sl at 3 km",
            None,
            kollsman_slope_mppa(P_3KM_PA, P0_PA),
            unit="m/Pa",
            where="(13)",
        ),
        compare(
            "500 m, sea level at 1000 hPa",
            500.0,
            kollsman_altitude_m(measured_pa, 100_000.0),
            1.0,
            unit="m",
            where="(13)",
            reading="the derivative taken at the measured pressure",
            note=f"uncorrected {pressure_altitude_m(measured_pa):.2f}; the rest is second order",
        ),
        compare(
            '3000 m, "gradient of altitude with pressure at sea level"',
            3000.0,
            with_sea_level_slope,
            1.0,
            unit="m",
            where="after (13)",
            note=f"with the local derivative {kollsman_altitude_m(at_3km_pa, 100_000.0):.1f}",
        ),
    ]


def _draw_cubic(page: Page) -> None:
    heights_m = np.linspace(-1000.0, 18_288.0, 400)
    pressure = standard_pressures_pa(heights_m)
    error_m = np.array([cubic_altitude_m(value) for value in pressure.tolist()]) - heights_m
    with page.figure(
        "cubic", "Error of the cubic (12) over its range: altitude and rate of climb.", columns=2
    ) as axes:
        axes[0].plot(heights_m / 1000.0, error_m, color=BARO)
        axes[0].set(title="altitude error (m)", xlabel="height (km)")
        axes[1].plot(heights_m / 1000.0, 100.0 * np.gradient(error_m, heights_m), color=BARO)
        axes[1].set(title="error of a rate of climb (%)", xlabel="height (km)")


# Section IV: spikes


def gate_on_accepted(pressure_pa: Array) -> NDArray[np.bool_]:
    """5 Pa against the last accepted value: one way to read the recommendation."""
    passed, last = np.zeros(pressure_pa.size, np.bool_), float(pressure_pa[0])
    for i, value in enumerate(pressure_pa.tolist()):
        passed[i] = abs(value - last) <= GATE_PA
        last = value if passed[i] else last
    return passed


def gate_on_last(pressure_pa: Array) -> NDArray[np.bool_]:
    """5 Pa against the last value, accepted or not: the other way."""
    return np.abs(np.diff(pressure_pa, prepend=pressure_pa[0])) <= GATE_PA


def gate_of_estimator(pressure_pa: Array, heights_m: Array, rate_hz: int) -> NDArray[np.bool_]:
    """What the estimator does with the same pressures, beside an exact fix a second."""
    log = SampleLog()
    for i, value in enumerate(pressure_pa.tolist()):
        time_us = SECOND_US + i * SECOND_US // rate_hz
        log.append(Kind.PRESSURE, sample(Kind.PRESSURE, time_us, pressure_pa=value, suspect=0))
        if i % rate_hz == 0:
            fix = sample(
                Kind.GNSS, time_us, altitude_amsl_m=heights_m[i], vertical_sd_m=3.0, fix_type=3
            )
            log.append(Kind.GNSS, fix)
    verdicts = run_log(METHOD, log)[1]
    return np.asarray(verdicts[log.tables.order["kind"] == Kind.PRESSURE] == Verdict.USED)


def descent(rate_hz: int, generator: np.random.Generator) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Pressures of 300 s from 4000 m downwards, true heights, and which of them are spikes."""
    heights_m = np.asarray(4000.0 - SINK_MPS / rate_hz * np.arange(300 * rate_hz), np.float64)
    spiked = generator.random(heights_m.size) < SPIKE_SHARE
    spiked[: 3 * rate_hz] = False
    size = SPIKE_PA * (120.0 / rate_hz if rate_hz < 10 else 1.0) / 12.0 + SPIKE_PA
    noise = NOISE_PA * generator.standard_normal(heights_m.size)
    return pressures_pa(heights_m) + noise + np.where(spiked, size, 0.0), heights_m, spiked


@dataclass
class Descents:
    """Shares of samples over the runs of one rate: of good ones rejected, of spikes passed; one of
    each a gate."""

    rejected: dict[str, Spread]
    passed: dict[str, Spread]

    @classmethod
    def of(cls, rate_hz: int, seeds: int) -> "Descents":
        rejected: dict[str, list[float]] = {}
        passed: dict[str, list[float]] = {}
        for generator in generators("R", seeds):
            pressure, heights_m, spiked = descent(rate_hz, generator)
            gates = {
                "accepted": gate_on_accepted(pressure),
                "last": gate_on_last(pressure),
                "trend": gate_of_estimator(pressure, heights_m, rate_hz),
            }
            for name, good in gates.items():
                rejected.setdefault(name, []).append(100.0 * float(np.mean(~good[~spiked])))
                if spiked.any():
                    passed.setdefault(name, []).append(100.0 * float(np.mean(good[spiked])))
        return cls(
            {k: spread(v) for k, v in rejected.items()}, {k: spread(v) for k, v in passed.items()}
        )


def _gate_rows(descents: list[Descents]) -> list[Row]:
    slope = (standard_pressure_pa(0.0) - standard_pressure_pa(1.0)) / 1.0
    fastest = tuple(GATE_PA * rate_hz / slope for rate_hz in GATE_RATES_HZ)

    def shares(which: str, gate: str) -> tuple[Spread, ...]:
        return tuple(getattr(each, which)[gate] for each in descents)

    latched = shares("rejected", "accepted")
    trend, spikes = shares("rejected", "trend"), shares("passed", "trend")
    return [
        Row(
            "fastest climb that 5 Pa between samples pass",
            ours=fastest,
            unit="m/s",
            where="sec. IV",
            note="at sea level, without noise",
        ),
        holds(
            "5 Pa from the last accepted pass good samples: rejected",
            at_most(max(each.mean for each in latched), 1.0),
            latched,
            unit="%",
            where="sec. IV",
            note="once the descent has left the threshold behind, everything is rejected for good",
        ),
        holds(
            "5 Pa from the last sample pass good samples: rejected",
            at_most(max(each.mean for each in shares("rejected", "last")), 1.0),
            shares("rejected", "last"),
            unit="%",
            where="sec. IV",
            note="works where 10 m/s are less than 5 Pa a sample",
        ),
        holds(
            "the estimator's trend gate: rejected",
            below(max(each.mean for each in trend[1:]), 0.1),
            trend,
            unit="%",
            note="at least 8 Pa, against the trend; under 0.1 % wanted at 10 Hz and more",
        ),
        holds(
            "spikes that the trend gate passes",
            at_most(max(each.mean for each in spikes), 0.0),
            spikes,
            unit="%",
            where="sec. IV",
            note=f"spikes of {SPIKE_PA + 5:.0f} Pa, of {SPIKE_PA * 11:.0f} Pa at 1 Hz, where a "
            "manoeuvre makes 120",
        ),
    ]


def _draw_gate(page: Page) -> None:
    pressure, heights_m, _ = descent(20, generators("R", 1)[0])
    times_s = np.arange(pressure.size) / 20.0
    gates = (
        ("5 Pa from the last accepted", gate_on_accepted(pressure), OTHER),
        ("5 Pa from the last sample", gate_on_last(pressure), INERTIAL),
        ("8 Pa from the trend", gate_of_estimator(pressure, heights_m, 20), FUSED),
    )
    caption = "A descent of 10 m/s at 20 Hz with 1 % spikes: samples rejected so far, by gate."
    with page.figure("gate", caption) as axes:
        for name, good, colour in gates:
            axes[0].plot(times_s, np.cumsum(~good), color=colour, label=name)
        axes[0].set(
            yscale="log", ylim=(0.8, 8000), xlabel="time (s)", title="samples rejected so far"
        )
        axes[0].legend()


# Section VI: bias and scale factor


class Profile:
    """Flights along true heights, one a second: h = h_p + b + s h_p with b = 25 m, s = 0.03."""

    def __init__(self, heights_m: Array) -> None:
        self.heights_m = heights_m
        self.h_p_m = (heights_m - B_M) / (1.0 + S)
        self.log = SampleLog()
        for second in range(heights_m.size):
            time_us = (second + 1) * SECOND_US
            self.log.append(Kind.PRESSURE, sample(Kind.PRESSURE, time_us, suspect=0))
            self.log.append(
                Kind.GNSS, sample(Kind.GNSS, time_us, vertical_sd_m=GNSS_SD_M, fix_type=3)
            )
        self.b_m: list[float] = []
        self.s: list[float] = []
        self.sum_m: list[float] = []
        self.sd: Array = np.zeros(3)

    def fly(self, generator: np.random.Generator) -> None:
        noise = generator.standard_normal((2, self.heights_m.size))
        self.log[Kind.PRESSURE]["pressure_pa"] = pressures_pa(self.h_p_m + BARO_SD_M * noise[0])
        self.log[Kind.GNSS]["altitude_amsl_m"] = self.heights_m + GNSS_SD_M * noise[1]
        state = run_log(METHOD, self.log, CONSTANT)[2][0]
        b, s = float(state["ins"]["b_m"]), float(state["ins"]["s"])
        self.b_m.append(b)
        self.s.append(s)
        self.sum_m.append(b + s * float(self.h_p_m[-1]))
        P, h_p = np.asarray(state["ins"]["P"]), float(self.h_p_m[-1])
        total = P[15, 15] + 2.0 * h_p * P[15, 16] + h_p**2 * P[16, 16]
        self.sd = np.sqrt([P[15, 15], P[16, 16], total])

    @property
    def rank(self) -> int:
        """Of what the barometer's row (16) shows of b and s along the whole profile."""
        rows = np.column_stack([np.ones(self.h_p_m.size), self.h_p_m])
        return int(np.linalg.matrix_rank(rows))


ERRORS_OF_16 = (2, 5, 15, 16)
"""dP_d, dv_d, b, s among the estimator's seventeen errors."""


def baro_row(dt_b: float) -> tuple[Array, Array]:
    """The estimator's row (16), and the derivative of its residual (15), for dP_d, dv_d, b, s.

    The row is read from the correction that a tiny variance of one error alone causes: dx = P H z /
    R.
    """
    pressure_pa = standard_pressure_pa(480.0)

    def corrected(index: int, variance: float, shift: float) -> tuple[float, float]:
        """Correction of one error, and the residual, with the state off by `shift` in it."""
        params = CONSTANT.params()
        state = METHOD.init(params)
        ins, baro = state[0]["ins"], state[0]["baro"]
        ins["P"][:] = 0.0
        ins["P"][index, index] = variance
        ins["time_us"], ins["position"][2], ins["velocity_n_mps"][2] = 0, 480.5, 2.0
        if index == ERRORS_OF_16[0]:
            ins["position"][2] -= shift
        elif index == ERRORS_OF_16[1]:
            ins["velocity_n_mps"][2] += shift
        elif index == ERRORS_OF_16[2]:
            ins["b_m"] += shift
        else:
            ins["s"] += shift
        baro["pressure_pa"], baro["h_p_m"] = pressure_pa, baro_altitude_m(pressure_pa)
        correct_baro(ins, baro, params, dt_b, 0.0, True, False)
        h, v = float(ins["position"][2]), float(ins["velocity_n_mps"][2])
        h_p = float(baro["h_p_m"])
        z = h_p - (h - v * dt_b - float(ins["b_m"]) - float(ins["s"]) * h_p)
        return float(ins["dx"][index]), z

    row, numeric = [], []
    for index in ERRORS_OF_16:
        found, z = corrected(index, 1e-12, 0.0)
        row.append(found / (1e-12 * z))
        step = 1e-6
        numeric.append(
            (corrected(index, 0.0, -step)[1] - corrected(index, 0.0, step)[1]) / (2 * step)
        )
    return np.array(row), np.array(numeric)


def driven_scale(generator: np.random.Generator, measured: bool) -> float:
    """s after ten minutes of level flight at 500 m with b and s of zero: a filter of b and s alone,
    h known.

    `measured`: the row (16) takes h_m from the measured pressure altitude, else the known one.
    """
    x, P = np.zeros(2), np.diag([100.0**2, 0.04**2])
    noise = 5.0 * generator.standard_normal(6000)
    for error in noise.tolist():
        h_p = 500.0 + error
        H = np.array([-1.0, -(h_p if measured else 500.0)])
        P[0, 0] += 0.09 * 0.1
        gain = P @ H / (H @ P @ H + 25.0)
        x += gain * (h_p * (1.0 + x[1]) + x[0] - 500.0)
        P -= np.outer(gain, H @ P)
    return float(x[1])


def _state_rows(level: Profile, climb: Profile) -> list[Row]:
    row, numeric = baro_row(0.02)
    streams = generators("R", min(len(level.b_m), 10))
    driven = spread([driven_scale(generator, measured=True) for generator in streams])
    fixed = spread([driven_scale(generator, measured=False) for generator in streams])
    reading = "after a climb from 100 to 1600 m, b and s constant"
    return [
        compare(
            "states",
            20,
            N,
            0,
            where="(14)",
            note="errors of ours: three of attitude for four of the quaternion, and no receiver "
            "clock (two), which "
            "needs pseudoranges",
        ),
        holds(
            "(16) is the derivative of (15)",
            at_most(float(np.abs(row / numeric - 1.0).max()), 0.05),
            ", ".join(f"{value:.3g}" for value in numeric),
            printed=", ".join(f"{value:.3g}" for value in row),
            where="(15), (16)",
            note="by dP_d, dv_d, b, s, of the estimator; the row holds 480.5 m in the place of "
            "h_p, 480 m",
        ),
        holds(
            "h_m in (16), the altitude that is measured, leaves s alone",
            at_most(abs(driven.mean), 0.01),
            driven,
            where="(16)",
            note="true 0: 5 m of noise, 10 Hz, ten minutes at 500 m; with an altitude without "
            f"that noise {fixed}",
        ),
        compare(
            "b in level flight",
            B_M,
            spread(level.b_m),
            1.0,
            unit="m",
            where="(14)",
            note=f"the rows (16) have rank {level.rank}: only b + s h_p is seen; the filter says "
            f"± {level.sd[0]:.0f} m",
        ),
        compare(
            "b + s h_p in level flight",
            B_M + S * float(level.h_p_m[-1]),
            spread(level.sum_m),
            0.2,
            unit="m",
            where="(15)",
            reading="as a sum",
            note=f"the filter says ± {level.sd[2]:.2f} m",
        ),
        compare(
            "b",
            B_M,
            spread(climb.b_m),
            0.1,
            unit="m",
            where="(14)",
            reading=reading,
            note=f"rank {climb.rank}; the filter says ± {climb.sd[0]:.2f} m",
        ),
        compare(
            "s",
            S,
            spread(climb.s),
            1e-4,
            where="(14)",
            reading=reading,
            note=f"the filter says ± {climb.sd[1]:.5f}",
        ),
        Row("sigma_b^2", "1.0 m", "1.0 m² in ours: a variance", where="after (16)"),
    ]


def _draw_states(page: Page, level: Profile, climb: Profile) -> None:
    caption = (
        "Bias and scale factor found by the filter, one point a seed (true 25 m and 0.03). In "
        "level flight only b + s h_p is seen (dashed: equal sums), and the points scatter along "
        "the gain of the priors (dotted), across the dashed line; after a climb they gather at "
        "one point."
    )
    with page.figure("states", caption, columns=2) as axes:
        for panel, profile, name in (
            (axes[0], level, "level at 800 m"),
            (axes[1], climb, "climb from 100 to 1600 m"),
        ):
            panel.plot(profile.b_m, profile.s, ".", color=FUSED, markersize=4, label="a seed")
            panel.plot([B_M], [S], "+", color=OTHER, markersize=12, label="truth")
            panel.set(title=name, xlabel="b (m)", ylabel="s")
        h_p, b = float(level.h_p_m[-1]), np.array(level.b_m)
        middle, around = float(b.mean()), np.array([b.min(), b.max()])
        ratio = CONSTANT.baro_scale_sd_ratio**2 * h_p / CONSTANT.baro_bias_sd_m**2
        at = float(np.mean(level.s))
        axes[0].plot(
            around,
            at - (around - middle) / h_p,
            color=BOUND,
            linestyle="--",
            label="equal b + s h_p",
        )
        axes[0].plot(
            around,
            at + ratio * (around - middle),
            color=BOUND,
            linestyle=":",
            label="gain of the priors",
        )
        axes[0].legend()
        axes[1].legend()


# Section VI: an outage

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

    def __init__(self, names: tuple[str, ...] = ("with", "without")) -> None:
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
            self._note(name, run_log(METHOD, log)[0], slow_m)

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


def _outage_rows(outage: Outage) -> list[Row]:
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


def _drift_rows(drifting: dict[float, Outage]) -> list[Row]:
    """Whether the reported spread is honest, by the drift of the weather."""
    rows = []
    for hpa_per_h, outage in drifting.items():
        nees, worst = spread(outage.share["with"]), spread(outage.worst_m["with"])
        row = holds(
            f"the spread reported in the outage is honest, weather {hpa_per_h:g} hPa/h: error "
            "squared over variance",
            below(nees.mean, 2.0),
            nees,
            note=f"1 is exact, less is cautious; largest error {worst} m",
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


def _draw_outage(page: Page, outage: Outage) -> None:
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

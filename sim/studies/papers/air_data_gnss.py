"""Paper W: Whang, Ra 2008, against `companion.estimators.air_data_gnss`.

The simulation of section 3: air data every 0.2 s (5 m, 1.5 K), GPS every second (70 m), a lapse
rate that is drawn anew every ten seconds. Samples reach the estimator as a vehicle would send them:
each barometer height becomes the pressure at which the standard atmosphere has it, each temperature
a sample of AIR, and `run_log` steps through the rows.

What the print leaves open, and what is wrong in it
---------------------------------------------------
- Figure 2, the trajectory, is not described: here two climbs to 180 m and back in 300 s.
- What moves the true a and b is not said. Three readings: weather (`WEATHER`), random walks with
  the filter's own Q per second (`WALK_SECOND`), and per step of 0.2 s (`WALK_STEP`).
- "0.003 degC/km around -0.0065 degC/km" is K/m.
- Figure 3 shows curves, no numbers: what can be held against it are the sentences about it.
"""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from companion.estimators.air_data_gnss import METHOD
from companion.estimators.air_data_gnss.settings import AirDataGnssSettings
from companion.estimators.method import Filter, run_log
from companion.kernels.atmosphere import (
    G0_MPS2,
    L0_KPM,
    P0_PA,
    R_AIR,
    T0_K,
    geopotential_m,
    standard_pressure_pa,
)
from companion.kernels.kalman import correct
from companion.samples import Kind, SampleLog, sample
from sim.studies.page import (
    BARO,
    BOUND,
    FUSED,
    GNSS,
    INERTIAL,
    OTHER,
    TRUTH,
    Spread,
    Value,
    generators,
    spread,
)
from sim.studies.papers import Progress, air_temperature
from sim.studies.papers.page import Page, Row, at_most, below, both, compare, holds

Array = NDArray[np.float64]
Law = Literal["exact", "linear", "printed"]

DT_S = 0.2
STEPS = 1500
GPS_EVERY = 5
LAPSE_EVERY = 50
BARO_SD_M, GPS_SD_M, TEMPERATURE_SD_K, LAPSE_SD_KPM = 5.0, 70.0, 1.5, 0.003
Q_A, Q_B = 2e-5, 400.0
SETTLED = 300
"""Errors count from here on: after a minute."""
BASE_M = 3000.0
"""H_0: random walks take the barometer down by more than the pressure of any valley would be
believed."""

TIME_S = DT_S * np.arange(STEPS)
HEIGHT_M = 90.0 * (1.0 - np.cos(2.0 * math.pi * TIME_S / 150.0))

WEATHER, WALK_SECOND, WALK_STEP = READINGS = (
    "weather",
    "random walk, Q per second",
    "random walk, Q per step",
)

SETTINGS = {
    "paper": AirDataGnssSettings(preset="paper"),
    "as printed": AirDataGnssSettings(preset="paper", temperature_law="printed", regressor="gnss"),
    "slow walks": AirDataGnssSettings(
        preset="paper",
        covariance="joint",
        scale_walk_per_second=1e-9 / DT_S,
        bias_walk_m2ps=0.01 / DT_S,
    ),
    "tuned": AirDataGnssSettings(
        gnss_variance_m2=GPS_SD_M**2, baro_variance_m2=BARO_SD_M**2, bias_sd_m=20.0
    ),
}
"""Ours: the paper's filter corrected, with its sign and regressor; with slow Q and joint covariance
and nothing else changed; and the preset ``tuned``, told what the simulation's sensors are like."""


def pressure_ratio(above_m: Any, temperature_k: Any, lapse_kpm: Any) -> Array:
    """P/P_0 at a height above the launch: the inverse of the corrected (1), for arrays of one
    shape."""
    return np.asarray(
        (1.0 + lapse_kpm * above_m / temperature_k) ** (-G0_MPS2 / (R_AIR * lapse_kpm))
    )


def baro_height_m(ratio: Any) -> Array:
    """(1) with R in the exponent (erratum), H_0 = 0, the standard T_0 and lapse rate."""
    return np.asarray(T0_K / L0_KPM * (np.asarray(ratio) ** (-R_AIR * L0_KPM / G0_MPS2) - 1.0))


@dataclass(frozen=True)
class Readings:
    """What the sensors say in one run, shape (STEPS,)."""

    baro_m: Array
    gps_m: Array
    temperature_k: Array
    base_m: float
    """the launch site, from which heights count"""
    final: tuple[float, float]
    """true a and b at the end; NaN where the air is no random walk"""


def readings(reading: str, rng: np.random.Generator) -> Readings:
    """One run under one reading of what moves the air."""
    lapse = np.repeat(rng.normal(L0_KPM, LAPSE_SD_KPM, STEPS // LAPSE_EVERY), LAPSE_EVERY)
    noise = rng.normal(size=(3, STEPS))
    base_m, final = 0.0, (math.nan, math.nan)
    if reading == WEATHER:
        sign = rng.choice([-1.0, 1.0], 2)
        ground_k = T0_K + sign[0] * rng.uniform(5.0, 15.0)
        drift = sign[1] * rng.uniform(100.0, 300.0) / 3600.0 * TIME_S + rng.normal(0.0, 50.0)
        ratio = (1.0 + drift / 101_325.0) * pressure_ratio(HEIGHT_M, ground_k, lapse)
        baro_m, temperature_k = baro_height_m(ratio), ground_k + lapse * HEIGHT_M
    else:
        base_m, step = BASE_M, DT_S if reading == WALK_SECOND else 1.0
        a = np.cumsum(rng.normal(0.0, math.sqrt(Q_A * step), STEPS))
        b = np.cumsum(rng.normal(0.0, math.sqrt(Q_B * step), STEPS))
        baro_m = HEIGHT_M + a * HEIGHT_M + b
        temperature_k = (T0_K + L0_KPM * BASE_M) * (1.0 - a) + lapse * HEIGHT_M
        final = float(a[-1]), float(b[-1])
    return Readings(
        baro_m + BARO_SD_M * noise[0],
        HEIGHT_M + GPS_SD_M * noise[1],
        temperature_k + TEMPERATURE_SD_K * noise[2],
        base_m,
        final,
    )


@dataclass(frozen=True)
class Run:
    """What the estimator made of one run; errors after each cycle."""

    final_m: Array
    compensated_m: Array
    """h^c (32), before the alpha-beta filter"""
    nees: float
    """of a and b at the end"""


class VehicleRows:
    """The rows that a vehicle would send, made once and filled for each run."""

    def __init__(self, gps_every: int = GPS_EVERY, steps: int = STEPS) -> None:
        self.log = SampleLog()
        self._fixes = slice(0, steps, gps_every)
        ends = []
        for step in range(steps):
            time_us = 1_000_000 + step * round(DT_S * 1e6)
            self.log.append(Kind.AIR, sample(Kind.AIR, time_us))
            if step % gps_every == 0:
                self.log.append(Kind.GNSS, sample(Kind.GNSS, time_us, fix_type=3))
            self.log.append(Kind.PRESSURE, sample(Kind.PRESSURE, time_us))
            ends.append(len(self.log) - 1)
        self._ends = np.array(ends)

    def run(self, data: Readings, settings: AirDataGnssSettings) -> Run:
        """One run of the estimator, through the loop that replays logs."""
        base_m = data.base_m
        pressures = [
            standard_pressure_pa(geopotential_m(height))
            for height in (base_m + data.baro_m).tolist()
        ]
        self.log[Kind.PRESSURE]["pressure_pa"] = pressures
        self.log[Kind.AIR]["air_temperature_k"] = data.temperature_k
        self.log[Kind.GNSS]["altitude_amsl_m"] = base_m + data.gps_m[self._fixes]
        based = settings.model_copy(update={"reference_height_m": base_m})
        estimates, _, state = run_log(METHOD, self.log, based)
        cycles = estimates[self._ends]
        error = state["error"]["x"][0] - data.final
        return Run(
            cycles["altitude_amsl_m"] - base_m - HEIGHT_M,
            data.baro_m + cycles["baro_offset_m"] - HEIGHT_M,
            float(error @ np.linalg.solve(state["error"]["P"][0], error)),
        )


def rms(errors_m: Array) -> float:
    return float(np.sqrt(np.mean(np.square(errors_m))))


def settled(errors_m: Array) -> float:
    """Root mean square after a minute."""
    return rms(errors_m[SETTLED:])


def temperature_alone_m(law: Law, warmer_k: float, height_m: float = 1600.0) -> float:
    """Error of the settled height in air that is `warmer_k` than standard, with no GPS: what lambda
    alone does."""
    above = geopotential_m(height_m)
    air_k = T0_K + warmer_k + L0_KPM * above
    pressure_pa = P0_PA * float(pressure_ratio(above, T0_K + warmer_k, L0_KPM))
    running = Filter(METHOD, AirDataGnssSettings(preset="paper", temperature_law=law))
    air, pressure = (
        sample(Kind.AIR, 0, air_temperature_k=air_k),
        sample(Kind.PRESSURE, 0, pressure_pa=pressure_pa),
    )
    for step in range(1, 301):
        air["time_us"] = pressure["time_us"] = step * round(DT_S * 1e6)
        running.step(Kind.AIR, air)
        running.step(Kind.PRESSURE, pressure)
    return float(running.estimate["altitude_amsl_m"][0]) - height_m


def printed_update(
    a: float, b: float, P_a: float, P_b: float, z: float, h: float, R: float
) -> tuple[float, float, float, float]:
    """The z-update as printed, (23)-(31), which divides by the height h."""
    z_a, S_a = (z - b) / h, (P_b + R) / h**2
    weight = P_a / (P_a + S_a)
    a, P_a = a + weight * (z_a - a), (1.0 - weight) * P_a
    K = P_b / (P_b + R)
    return a, b + K * (z - h * a - b), P_a, (1.0 - K) * P_b + (K * h) ** 2 * P_a


def update_difference(rng: np.random.Generator, draws: int = 500) -> float:
    """Largest relative difference of `printed_update` and a joint Kalman correction without its
    correlation."""
    worst, floor = 0.0, np.array([1e-3, 1.0, 0.0, 0.0])
    for _ in range(draws):
        a, b, z = rng.normal(size=3) * (0.05, 30.0, 60.0)
        P_a, P_b, R, h = np.exp(rng.uniform((-12.0, 0.0, 1.0, 2.0), (-3.0, 8.0, 9.0, 8.0)))
        printed = np.array(printed_update(a, b, P_a, P_b, z, h, R))
        x, P, H = np.array([a, b]), np.diag([P_a, P_b]), np.array([h, 1.0])
        correct(x, P, H, np.empty(2), z - h * a - b, R)
        ours = np.array([*x, P[0, 0], P[1, 1]])
        worst = max(worst, float(np.max(np.abs(ours - printed) / (np.abs(printed) + floor))))
    return worst


def normalised_errors(covariance: Literal["joint", "marginal"], seeds: int) -> Array:
    """Normalised error squared of [a, b] at the end of runs whose air is exactly the filter's
    model, 1-2 km up.

    No thermometer: what is known of a comes from fixes, together with b.
    """
    q_a, q_b = 2e-7, 4.0
    settings = AirDataGnssSettings(
        preset="paper", covariance=covariance, temperature="none",
        scale_walk_per_second=q_a / 0.2, bias_walk_m2ps=q_b / 0.2, scale_sd=0.02,
    )  # fmt: skip
    stream, height_m = VehicleRows(), 1000.0 + 6.0 * HEIGHT_M
    nees = []
    for rng in generators("W", seeds):
        a = 0.02 * rng.normal() + np.cumsum(math.sqrt(q_a) * rng.normal(size=STEPS))
        b = 20.0 * rng.normal() + np.cumsum(math.sqrt(q_b) * rng.normal(size=STEPS))
        noise = rng.normal(size=(2, STEPS))
        data = Readings(
            height_m + a * height_m + b + BARO_SD_M * noise[0],
            height_m + GPS_SD_M * noise[1],
            np.full(STEPS, math.nan),
            0.0,
            (float(a[-1]), float(b[-1])),
        )
        nees.append(stream.run(data, settings).nees)
    return np.array(nees)


@dataclass
class Figures:
    """The errors of all runs under one reading."""

    errors: dict[str, list[Array]] = field(default_factory=dict)

    def add(self, name: str, error_m: Array) -> None:
        self.errors.setdefault(name, []).append(error_m)

    def rms(self, name: str) -> Spread:
        """Over time, mean and spread over the seeds."""
        return spread([settled(error) for error in self.errors[name]])

    def total(self, name: str) -> float:
        """Root mean square over time and seeds."""
        return rms(np.array(self.errors[name])[:, SETTLED:])

    def curve(self, name: str) -> Array:
        """Root mean square over the seeds at each instant, as Fig. 3 has it."""
        return np.asarray(np.sqrt(np.mean(np.square(self.errors[name]), axis=0)))


COLOURS = {
    "barometer": BARO,
    "GPS": GNSS,
    "compensated": INERTIAL,
    "paper": FUSED,
    "tuned": TRUTH,
}
SPARSE = {"1 s": GPS_EVERY, "10 s": 50, "60 s": 300}
"""Intervals of GPS."""


def monte_carlo(reading: str, seeds: int, stream: VehicleRows) -> Figures:
    """All settings on the same readings, one set a seed."""
    found = Figures()
    for rng in generators("W", seeds):
        data = readings(reading, rng)
        found.add("barometer", data.baro_m - HEIGHT_M)
        found.add("GPS", data.gps_m - HEIGHT_M)
        for name, settings in SETTINGS.items():
            run = stream.run(data, settings)
            found.add(name, run.final_m)
            if name == "paper":
                found.add("compensated", run.compensated_m)
    return found


def reproduce(seeds: int, out: Path, progress: Progress) -> Page:
    """The page of paper W."""
    stream, found = VehicleRows(), {}
    for done, reading in enumerate(READINGS):
        progress(0.2 * done, reading)
        found[reading] = monte_carlo(reading, seeds, stream)
    progress(0.6, "sparse GPS")
    sparse = {name: _sparse(VehicleRows(every), seeds) for name, every in SPARSE.items()}
    progress(0.8, "page")
    page = Page("W", seeds, out)
    page.text(
        "Barometer height and air temperature every 0.2 s (5 m, 1.5 K), GPS height every second "
        "(70 m), a lapse rate that changes by 3 K/km every ten seconds, two climbs to 180 m in "
        "five minutes. The paper draws its trajectory but does not say what moves the air, so "
        "there are three readings: weather (a ground temperature 5-15 K off, 1-3 hPa an hour, a "
        "start within 0.5 hPa), and random walks of a and b with the filter's Q taken per second "
        "or per step. Root mean squares count from one minute on; samples go through the loop "
        "that replays logs."
    )
    page.table("The equations as printed", _equation_rows())
    _draw_temperature(page)
    page.table("Figure 3: what the errors come to", _error_rows(found), READINGS)
    _draw_curves(page, found)
    page.table("The claims", _claim_rows(found, sparse))
    _add_remedies(page, found, sparse)
    _add_live(page)
    return page


def _sparse(stream: VehicleRows, seeds: int) -> Figures:
    found = Figures()
    for rng in generators("W", seeds):
        data = readings(WEATHER, rng)
        for name in ("paper", "tuned"):
            found.add(name, stream.run(data, SETTINGS[name]).final_m)
    return found


def _equation_rows() -> list[Row]:
    printed_height_m = T0_K / L0_KPM * (0.9 ** (-L0_KPM / G0_MPS2) - 1.0)
    bias_m = R_AIR * T0_K / G0_MPS2 * 100.0 / P0_PA
    low_m = float(baro_height_m(1.0 + 100.0 / P0_PA))
    return [
        compare("height at 0.9 P_0", printed_height_m, float(baro_height_m(0.9)), 0.5, unit="m",
                where="(1)",
                note="the gas constant is missing in the exponent"),
        compare("b when the ground pressure is 1 hPa higher", bias_m, low_m, 0.1, unit="m",
                where="(4)",
                note="higher pressure reads lower"),
        compare("corrected height at 1600 m, air 15 K warmer, error", 0.0,
                temperature_alone_m("printed", 15.0),
                5.0, unit="m", where="(3), (6)",
                note="as printed, temperature doubles the error it should remove"),
        compare("the same with lambda negative", 0.0, temperature_alone_m("linear", 15.0), 5.0,
                unit="m", where="(6)",
                reading="with a minus"),
        compare("the same with T_0/T_0' - 1", 0.0, temperature_alone_m("exact", 15.0), 0.1,
                unit="m",
                reading="with a minus and not linearised"),
        compare("sd of lambda at H_0", math.sqrt(TEMPERATURE_SD_K**2 / T0_K),
                TEMPERATURE_SD_K / T0_K, 1e-4,
                where="(7)", note="the denominator must be T_0 squared"),
        holds("the z-update is the exact posterior of a and b",
              at_most(update_difference(np.random.default_rng(1)), 1e-9),
              f"differs by {update_difference(np.random.default_rng(1)):.0e}", where="(23)-(31)",
              note="it is a Kalman correction of [a, b] that forgets the correlation of the two; "
                  "this one does not "
              "divide by the height"),
    ]  # fmt: skip


def _error_rows(found: dict[str, Figures]) -> list[Row]:
    def row(claim: str, name: str, printed: Value = None) -> Row:
        return Row(
            claim,
            printed,
            tuple(found[reading].rms(name) for reading in READINGS),
            unit="m",
            where="Fig. 3",
        )

    away_m = max(abs(found[reading].total("GPS") - GPS_SD_M) for reading in READINGS)
    gps = replace(row("GPS", "GPS", 70.0), check=at_most(away_m, 1.0))
    return [
        row("barometer height", "barometer"),
        gps,
        row("compensated height h^c", "compensated"),
        row("final height", "paper"),
        row("final height, sign and regressor as printed", "as printed"),
    ]


def _claim_rows(found: dict[str, Figures], sparse: dict[str, Figures]) -> list[Row]:
    final = {reading: found[reading].total("paper") for reading in READINGS}
    words = ", ".join(f"{value:.1f}" for value in final.values())
    smoothed = both(
        *(below(final[reading], found[reading].total("compensated")) for reading in READINGS)
    )
    weather, raw = found[WEATHER].rms("paper"), found[WEATHER].rms("barometer")
    rare = {name: figures.total("paper") for name, figures in sparse.items()}
    return [
        holds("errors are held under the level of GPS",
              below(max(final.values()), GPS_SD_M), f"{words} (GPS 70)", unit="m",
              where="sec. 3"),
        holds("filtering improves the compensated height", smoothed, f"final {words}", unit="m",
              where="sec. 2.4"),
        holds("accurate height, where a barometer alone has large errors: weather",
              below(weather.mean, raw.mean),
              f"{weather}, barometer {raw}", unit="m", where="abstract, sec. 4",
              note="under weather the correction is noisier than what it corrects"),
        holds("the same, a and b the random walks of Q",
              both(*(below(final[reading], found[reading].total("barometer"))
                     for reading in READINGS[1:])),
              words, unit="m", where="sec. 3", reading="45 m in a second"),
        holds("fair accuracy when GPS is rare", below(rare["60 s"], 1.2 * rare["1 s"]),
              ", ".join(f"every {name}: {value:.1f}" for name, value in rare.items()), unit="m",
              where="sec. 2.1",
              note="with this Q the bias is forgotten within seconds, and each rare fix is taken "
                  "almost as it is"),
    ]  # fmt: skip


def _add_remedies(page: Page, found: dict[str, Figures], sparse: dict[str, Figures]) -> None:
    page.text(
        "The structure is sound: for a constant lapse rate the error of a barometer is exactly "
        "affine in height. What spoils it is Q, which lets b move by 20 m in 0.2 s. *slow walks* "
        "changes nothing but Q^a = 1e-9 and Q^b = 0.01 a step and keeps the correlation of a and "
        "b; *tuned* is our preset with the noise of this simulation."
    )
    names = {
        "barometer": "raw barometer",
        "paper": "paper, corrected",
        "slow walks": "slow walks",
        "tuned": "tuned",
    }
    weather = found[WEATHER]
    rows: list[list[Value]] = [
        [words, weather.rms(name), weather.total(name)] for name, words in names.items()
    ]
    page.grid("Final height under weather", ["filter", "RMS (m)", "over all seeds (m)"], rows)
    rows = [[name, figures.rms("paper"), figures.rms("tuned")] for name, figures in sparse.items()]
    page.grid(
        "Final height under weather with rarer GPS", ["GPS every", "paper (m)", "tuned (m)"], rows
    )
    marginal, joint = (
        spread(normalised_errors(covariance, page.seeds)) for covariance in ("marginal", "joint")
    )
    page.text(
        "Do P^a and P^b tell the error of a and b? Between 1 and 2 km, without a thermometer, "
        "with walks that are exactly the filter's model, the normalised error squared of [a, b] "
        f"should average 2. It is {marginal} when the correlation is forgotten after each fix, as "
        f"in the paper, and {joint} when it is kept."
    )


PARKED_S = 25.0


def _add_live(page: Page) -> None:
    """The temperature update on a simulated flight, through the pipeline."""
    with_probe, without = air_temperature.fly()
    end, parked = (float(np.interp(at_s, *with_probe.curve)) for at_s in (1e9, PARKED_S))
    blind = float(np.interp(PARKED_S, *without.curve))
    page.text(
        "Live, HYGROMETER_SENSOR carries the air temperature (once a second); "
        "SCALED_PRESSURE.temperature_press_diff and HIGHRES_IMU.temperature are used where "
        "`intake.air_temperature` says so, and `air.temperature_c` or a METAR tell it once. The "
        "simulated vehicle sends a probe's reading with its errors (`sensors.thermometer`)."
    )
    page.table(
        f"A simulated flight in air {air_temperature.WARMER_K:g} K warmer than standard, through "
        "the pipeline",
        [
            *(compare(f"scale factor a {when}", air_temperature.TRUE_SCALE, value, 0.005,
                      where=where, note=note)
              for when, value, where, note in (
                  ("at the end, with the probe", end, "(6), (20)-(22)",
                   f"{with_probe.temperatures} temperatures used"),
                  (f"after {PARKED_S:g} s at rest, with the probe", parked, "(6), (20)-(22)", ""),
                  (f"after {PARKED_S:g} s at rest, without", blind, "(23)-(31)",
                   "GNSS alone needs a climb"))),
        ],
    )  # fmt: skip
    with page.figure("live", "Scale factor on the simulated flight, live.") as (axes,):
        for scales, label, colour in (
            (with_probe, "with the probe", FUSED),
            (without, "without", OTHER),
        ):
            axes.plot(*scales.curve, color=colour, label=label)
        axes.axhline(air_temperature.TRUE_SCALE, color=TRUTH, linewidth=0.8, label="true")
        axes.set(title="scale factor a", xlabel="time (s)")
        axes.legend()


def _draw_temperature(page: Page) -> None:
    warmer = np.arange(-30.0, 31.0, 5.0)
    caption = (
        "Height error at 1600 m against the air's temperature: barometer alone, lambda as "
        "printed, and corrected."
    )
    with page.figure("temperature", caption) as (axes,):
        ratio = pressure_ratio(1600.0, T0_K + warmer, L0_KPM)
        axes.plot(warmer, baro_height_m(ratio) - 1600.0, color=BARO, label="barometer")
        laws: tuple[tuple[Law, str], ...] = (
            ("printed", OTHER),
            ("linear", FUSED),
            ("exact", INERTIAL),
        )
        for law, colour in laws:
            axes.plot(
                warmer,
                [temperature_alone_m(law, kelvin) for kelvin in warmer.tolist()],
                color=colour,
                label=law,
            )
        axes.set(title="error (m)", xlabel="warmer than standard (K)")
        axes.legend()


def _draw_curves(page: Page, found: dict[str, Figures]) -> None:
    caption = (
        "RMS error over the seeds (the paper's Fig. 3) under three readings of what moves "
        "the air; our trajectory."
    )
    with page.figure("rms", caption, rows=4, sharex=True, panel_in=1.9) as axes:
        axes[0].plot(TIME_S, HEIGHT_M, color=TRUTH, label="true height")
        axes[0].set(title="height (m)")
        for panel, (reading, figures) in zip(axes[1:], found.items(), strict=True):
            for name, colour in COLOURS.items():
                if name != "tuned" or reading == WEATHER:
                    panel.plot(TIME_S, figures.curve(name), color=colour, label=name, linewidth=0.9)
            panel.axhline(GPS_SD_M, color=BOUND, linewidth=0.8, linestyle=":", label="70 m")
            highest = max(80.0, float(np.max(figures.curve("barometer"))))
            panel.set(title=f"RMS error (m): {reading}", ylim=(0, 1.1 * highest))
        handles, names = axes[1].get_legend_handles_labels()
        first, labels = axes[0].get_legend_handles_labels()
        axes[0].legend(first + handles, labels + names, ncols=4, loc="lower center")
        axes[3].set(xlabel="time (s)")

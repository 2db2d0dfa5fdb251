"""The tables of paper W's page."""

import math
from dataclasses import replace

import numpy as np

from companion.kernels.atmosphere import G0_MPS2, L0_KPM, P0_PA, R_AIR, T0_K
from companion.plots.style import FUSED, OTHER, TRUTH
from sim.studies.page import Value, generators, spread
from sim.studies.papers.air_data_gnss import air_temperature
from sim.studies.papers.air_data_gnss.simulation import (
    GPS_SD_M,
    READINGS,
    TEMPERATURE_SD_K,
    WEATHER,
    Figures,
    baro_height_m,
    normalised_errors,
    temperature_alone_m,
    update_difference,
)
from sim.studies.papers.page import Page, Row, at_most, below, both, compare, holds


def equation_rows() -> list[Row]:
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
              at_most(update_difference(generators("W update", 1)[0]), 1e-9),
              f"differs by {update_difference(generators('W update', 1)[0]):.0e}",
              where="(23)-(31)",
              note="it is a Kalman correction of [a, b] that forgets the correlation of the two; "
                  "this one does not "
              "divide by the height"),
    ]  # fmt: skip


def error_rows(found: dict[str, Figures]) -> list[Row]:
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


def claim_rows(found: dict[str, Figures], sparse: dict[str, Figures]) -> list[Row]:
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


def add_remedies(page: Page, found: dict[str, Figures], sparse: dict[str, Figures]) -> None:
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


def add_live(page: Page) -> None:
    """The temperature update on a simulated flight, through the pipeline."""
    with_probe, without = air_temperature.fly()
    end, parked = (float(np.interp(at_s, *with_probe.curve)) for at_s in (1e9, PARKED_S))
    blind = float(np.interp(PARKED_S, *without.curve))
    page.text(
        "Live, HYGROMETER_SENSOR carries the air temperature (once a second); "
        "SCALED_PRESSURE.temperature_press_diff and HIGHRES_IMU.temperature are used where "
        "`intake.air_temperature` says so, and `air.temperature_c` or a METAR tell it once. H_0 "
        "is `reference_height_m` until a QNH or the elevation of the field is told "
        "(`air.qnh_hpa`, a METAR, or the parameters AIR_QNH_HPA and AIR_FIELD_M in flight); then "
        "it is the height of the field, and T_0 the standard's there. The "
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

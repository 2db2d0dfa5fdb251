"""The tables of paper H's page."""

from dataclasses import replace

import numpy as np

from companion.estimators.adaptive_fusion import gain
from sim.studies.page import Value, spread
from sim.studies.papers.adaptive_fusion.simulation import (
    DRIFT,
    LITERAL,
    PRESSURE_KPA,
    R_B,
    R_GPS,
    R_PRINTED,
    TABLE_1,
    Run,
    Tally,
    height_m,
    setting_difference_m,
)
from sim.studies.papers.page import Page, Row, at_most, below, compare, holds, near


def descent_rows() -> list[Row]:
    top, bottom = (
        float(height_m(p, gas_constant=R_PRINTED)) for p in (PRESSURE_KPA[0], PRESSURE_KPA[-1])
    )
    fitting_top, fitting_bottom = (float(height_m(p)) for p in (PRESSURE_KPA[0], PRESSURE_KPA[-1]))
    reading = "with R = 287.05"
    return [
        compare("height at 23 kPa, R = 287", 10894.0, top, 0.5, unit="m", where="(1)"),
        compare(
            "height at 23 kPa", 10894.0, fitting_top, 0.5, unit="m", where="(1)", reading=reading
        ),
        compare("height at 99.85 kPa, R = 287", 123.47, bottom, 0.005, unit="m", where="(1)"),
        compare(
            "height at 99.85 kPa",
            123.47,
            fitting_bottom,
            0.005,
            unit="m",
            where="(1)",
            reading=reading,
        ),
        compare(
            "iterations", 1560, PRESSURE_KPA.size, 0, where="sec. 5", note="(99.85 - 23) / 0.05 + 1"
        ),
    ]


def nominal_rows(nominal: Tally) -> list[Row]:
    fixed, baro, gnss = nominal.rms("fixed_m"), nominal.rms("baro_m"), nominal.rms("gnss_m")
    mean_square = spread(np.square(nominal.rmse["fixed_m"]))
    return [
        compare(
            "P of the fixed filter",
            54.756,
            R_GPS * gain(1.0, R_B, R_GPS),
            5e-4,
            unit="m²",
            where="(17)",
        ),
        compare("its mean square error", 54.756, mean_square, 0.5, unit="m²", where="sec. 5"),
        holds(
            "the fixed filter is better than either sensor",
            below(fixed.mean, min(baro.mean, gnss.mean)),
            f"RMSE {fixed}, barometer {baro}, GPS {gnss}",
            unit="m",
            where="Figs. 2-4",
        ),
        holds(
            "the adaptive filter leaves good measurements alone",
            below(nominal.rms("adaptive_m").mean, 1.02 * fixed.mean),
            f"RMSE {nominal.rms('adaptive_m')}, fixed {fixed}",
            unit="m",
            where="abstract",
            note="(28) fires at one standard deviation: without any fault in "
            f"{100 * spread(nominal.fired).mean:.1f} % of the steps",
        ),
        holds(
            "S is a factor on a variance, never negative: share of steps with S < 0, (31) as "
            "printed",
            at_most(spread(nominal.negative).mean, 0.0),
            spread(nominal.negative),
            printed=0.0,
            where="(31)",
            note="without the condition (28), S is negative whenever the sensors agree within 13 "
            "m; K has a pole at a "
            "residual of 0. S = max(1, .) is meant",
        ),
    ]


def table_1_rows(drift: Tally, literal: Tally) -> list[Row]:
    rows = []
    for iteration, printed in TABLE_1.items():
        ours, other = spread(drift.variance_m2[iteration]), spread(literal.variance_m2[iteration])
        row = compare(
            f"P at iteration {iteration}",
            printed,
            ours,
            2.0 * ours.sd,
            reading="k in kPa",
            unit="m²",
            note="within 2 sd of a run; k the iteration: a drift of "
            f"{abs(LITERAL.bias_m[iteration - 1]):.0f} m, "
            f"{abs(other.mean - printed) / max(other.sd, 1e-9):.0f} sd away",
        )
        rows.append(replace(row, ours=(ours, other)))
    return rows


def drift_rows(drift: Tally, example: Run) -> list[Row]:
    adaptive, fixed = drift.rms("adaptive_m"), drift.rms("fixed_m")
    gnss, baro = drift.rms("gnss_m"), drift.rms("baro_m")
    factor = example.factor
    return [
        holds(
            "barometer and fixed filter are considerably worse than GPS",
            below(2 * gnss.mean, min(fixed.mean, baro.mean)),
            f"RMSE {baro} and {fixed}, GPS {gnss}",
            unit="m",
            where="Fig. 6",
        ),
        holds(
            "the adaptive filter is better than the fixed one",
            below(adaptive.mean, fixed.mean),
            f"RMSE {adaptive}, fixed {fixed}",
            unit="m",
            where="Fig. 9",
        ),
        holds(
            "its error variance is below that of GPS",
            below(adaptive.mean**2, gnss.mean**2),
            f"mean square {spread(np.square(drift.rmse['adaptive_m']))}, GPS "
            f"{spread(np.square(drift.rmse['gnss_m']))}",
            unit="m²",
            where="Table 1, (21)",
            note="P is below R_GPS by construction; it is not the variance of the error",
        ),
        holds(
            "S grows with the drift",
            below(float(np.mean(factor[:200])), float(np.mean(factor[-200:]))),
            f"{np.mean(factor[:200]):.0f} at first, {np.mean(factor[-200:]):.0f} at last (one run)",
            where="Fig. 10",
        ),
    ]


def property_rows() -> list[Row]:
    gains = [gain(S, R_B, R_GPS) for S in (1.0, 3.0, 10.0)]
    small, large = 1e-3, 1e6
    K, P = gain(1.0, R_B, R_GPS), R_GPS * gain(1.0, R_B, R_GPS)
    closed = R_B * R_GPS / (R_B + R_GPS)
    return [
        holds("0 < K < 1", below(0.0, K, 1.0), K, where="(20)"),
        holds("0 < P < R_GPS", below(0.0, P, R_GPS), P, unit="m²", where="(21)"),
        compare("P = R_B R_GPS / (R_B + R_GPS)", closed, P, 1e-9, unit="m²", where="(22)"),
        compare("R_B - P = P R_B / R_GPS", P * R_B / R_GPS, R_B - P, 1e-9, unit="m²", where="(23)"),
        holds("R_B > P", below(P, R_B), P, unit="m²", where="(24)"),
        holds(
            "K decreases as S increases",
            below(*reversed(gains)),
            ", ".join(f"K({S}) = {value:.3f}" for S, value in zip((1, 3, 10), gains, strict=True)),
            where="after (30)",
            note="it rises; the text's conclusion, more weight on GPS, is right",
        ),
        holds(
            "R_B >> R_GPS: K = 1, P = R_GPS",
            near(gain(1.0, large, R_GPS), 1.0, 1e-3),
            f"K = {gain(1.0, large, R_GPS):.4f}, P = {R_GPS * gain(1.0, large, R_GPS):.2f}",
            where="(25)",
        ),
        holds(
            "R_B << R_GPS: P tends to 0",
            below(R_GPS * gain(1.0, small, R_GPS), 0.5 * small),
            f"P = {R_GPS * gain(1.0, small, R_GPS) / small:.4f} R_B",
            where="after (25)",
            note="P tends to R_B",
        ),
        holds(
            "h^B with p_0(k), T_0(k) told live: largest difference from the formula",
            at_most(setting_difference_m(), 1e-6),
            f"{setting_difference_m():.0e}",
            unit="m",
            where="(31)",
            note="AIR samples, as `air.qnh_hpa`, `air.temperature_c` or the parameters "
            "AIR_QNH_HPA, AIR_TEMP_C, AIR_FIELD_M make them in flight; geopotential",
        ),
        Row(
            "computing time, adaptive over fixed",
            f"{0.024544 / 0.021502:.2f}",
            "timed by `python -m tests.bench papers`",
            where="sec. 5",
            note="a ratio of times depends on the machine, so it is no part of a page that "
            "rebuilds byte for byte",
        ),
    ]


def add_true_error(page: Page, drift: Tally) -> None:
    page.text(
        "When (28) fires, the estimate is exactly h_GPS - R_GPS / residual: GPS height, pushed "
        "away from the barometer. With a barometer error b its mean square error is R_GPS + 3 "
        "R_GPS^2 / b^2 to second order, above that of GPS alone (169 m²) at every drift, while P "
        "stays below."
    )
    mean_square = drift.mean_square_m2("adaptive_m")
    rows: list[list[Value]] = []
    for iteration, values in drift.variance_m2.items():
        near = slice(iteration - 26, iteration + 25)
        bias_m = float(DRIFT.bias_m[iteration - 1])
        expected_m2 = R_GPS + 3 * R_GPS**2 / bias_m**2
        rows.append(
            [
                str(iteration),
                f"{bias_m:.1f}",
                spread(values).mean,
                expected_m2,
                float(mean_square[near].mean()),
            ]
        )
    header = [
        "iteration",
        "b (m)",
        "P, mean (m²)",
        "R_GPS + 3 R_GPS^2 / b^2 (m²)",
        "mean square error (m²), 51 steps",
    ]
    page.grid("What the adaptive filter's error is", header, rows)

"""Paper R, section VI: bias and scale factor (15), (16) in level flight and in a climb."""

import numpy as np
from numpy.typing import NDArray

from companion.estimators.baro_gnss_ins import METHOD
from companion.estimators.baro_gnss_ins.barometer import correct_baro
from companion.estimators.baro_gnss_ins.filter import N
from companion.estimators.baro_gnss_ins.settings import BaroGnssInsSettings
from companion.estimators.method import run_log
from companion.kernels.atmosphere import baro_altitude_m, standard_pressure_pa
from companion.plots.style import BOUND, FUSED, OTHER
from companion.samples import Kind, SampleLog, sample
from sim.studies.page import generators, spread
from sim.studies.papers.baro_gnss_ins.formulas import SECOND_US, pressures_pa
from sim.studies.papers.page import Page, Row, at_most, compare, holds

Array = NDArray[np.float64]
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


def state_rows(level: Profile, climb: Profile) -> list[Row]:
    row, numeric = baro_row(0.02)
    streams = generators("R", min(len(level.b_m), 10))
    driven = spread([driven_scale(generator, measured=True) for generator in streams])
    fixed = spread([driven_scale(generator, measured=False) for generator in streams])
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
        *_found_rows(level, climb),
        Row("sigma_b^2", "1.0 m", "1.0 m² in ours: a variance", where="after (16)"),
    ]


def _found_rows(level: Profile, climb: Profile) -> list[Row]:
    """What the filter finds of b and s."""
    reading = "after a climb from 100 to 1600 m, b and s constant"
    return [
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
    ]


def draw_states(page: Page, level: Profile, climb: Profile) -> None:
    caption = (
        "Bias and scale factor found by the filter, one point a seed (true 25 m and 0.03). In "
        "level flight only b + s h_p is seen: the points lie on the line of the true sum (dashed) "
        "where the gain of the priors, from b = s = 0, crosses it (dotted), and scatter along that "
        "gain; after a climb they gather at the truth."
    )
    h_p = float(level.h_p_m[-1])
    ratio = CONSTANT.baro_scale_sd_ratio**2 * h_p / CONSTANT.baro_bias_sd_m**2
    with page.figure("states", caption, columns=2) as axes:
        for panel, profile, name in (
            (axes[0], level, "level at 800 m"),
            (axes[1], climb, "climb from 100 to 1600 m"),
        ):
            panel.plot(profile.b_m, profile.s, ".", color=FUSED, markersize=4, label="a seed")
            panel.plot([B_M], [S], "P", color=OTHER, markersize=10, label="truth", zorder=3)
            panel.set(title=name, xlabel="b (m)", ylabel="s")
        b_m = np.array([B_M - 0.5, max(level.b_m) + 1.0])
        for s, style, label in (
            (S - (b_m - B_M) / h_p, "--", "true b + s h_p"),
            (ratio * b_m, ":", "gain of the priors"),
        ):
            axes[0].plot(b_m, s, color=BOUND, linestyle=style, linewidth=1.4, label=label)
        axes[0].legend()
        axes[1].legend()

"""Paper C: whole samples (force, pressure, fix) through the estimator's `run`."""

import math

import numpy as np
from numpy.typing import NDArray

from companion.estimators.robust_altimeter import METHOD
from companion.estimators.robust_altimeter.settings import PUBLISH
from companion.kernels.atmosphere import geopotential_m, standard_pressure_pa
from companion.kernels.earth import gravity_mps2
from companion.samples import ESTIMATE, Kind, SampleLog, rows, sample
from sim.studies.page import Value, spread
from sim.studies.papers.page import Page
from sim.studies.papers.robust_altimeter.altimeter_errors import ALTIMETERS, START_SD, T_D_S, Model
from sim.studies.papers.robust_altimeter.models import TABLE_1, Outcome

Array = NDArray[np.float64]
LIVE_SEEDS = 10
LEAD = 6
"""Iterations of the IMU alone before the first pressure and fix: the attitude is aligned in
them."""


def live_log(model: Model, draw: Array) -> SampleLog:
    """What a level vehicle 1000 m up would send: 10 Hz of specific force, a pressure and a fix in
    each iteration.

    The specific force has the errors of (5) and (6), pressure and fix the noise of (13) and (18).
    """
    a, g, bias = (sd * float(value) for sd, value in zip(START_SD[2:], draw[0, 2:5], strict=True))
    log = SampleLog()
    imu = sample(Kind.IMU, 0, angular_rate_b_radps=0.0)
    pressure = sample(Kind.PRESSURE, 0)
    fix = sample(Kind.GNSS, 0, vertical_sd_m=2.23, fix_type=3)
    for i in range(-LEAD, draw.shape[0] - 1):
        at_us = 1_000_000 * (LEAD + 1) + round(i * T_D_S * 1e6)
        imu["specific_force_b_mps2"] = (0.0, 0.0, -(gravity_mps2(45.0, 0.0) + a + g))
        for part in range(5):
            imu["time_us"] = at_us - 450_000 + part * 100_000
            log.append(Kind.IMU, imu)
        if i < 0:
            continue
        noise = draw[i + 1]
        read_m = geopotential_m(1000.0 + bias + math.sqrt(10.0) * float(noise[3]))
        pressure["time_us"], pressure["pressure_pa"] = at_us, standard_pressure_pa(read_m)
        log.append(Kind.PRESSURE, pressure)
        fix["time_us"], fix["altitude_amsl_m"] = (
            at_us,
            1000.0 + math.sqrt(13.9729) * float(noise[4]),
        )
        log.append(Kind.GNSS, fix)
        a += T_D_S * (model.sigma_a * noise[0] - 0.001 * a)
        g += T_D_S * (2e-5 * noise[1] - 0.005 * g)
        bias += T_D_S * (model.sigma_ub * noise[2] - 0.01 * bias)
    return log


def live_errors_m(model: Model, log: SampleLog, publish: str) -> Array:
    """Errors of whole samples through the estimator's `run`; the datum of the barometer is
    known."""
    params = model.params()
    params["publish"], params["reference_s"] = PUBLISH[publish], 1e18
    state = METHOD.init(params)
    datum = state["pair"]["datum"]
    datum["offset_m"], datum["at_m"], datum["age_s"] = 0.0, 1000.0, 1e18
    estimates, verdicts = rows(ESTIMATE, len(log)), np.zeros(len(log), np.int64)
    METHOD.run(state, params, log.tables, estimates, verdicts)
    return np.asarray(estimates["altitude_amsl_m"][5 * LEAD + 6 :: 7] - 1000.0)


def add_live(page: Page, outcome: Outcome, draws: Array) -> None:
    free = next(iter(outcome.values()))[0]
    logs = [live_log(TABLE_1, draw) for draw in draws]
    lines: list[list[Value]] = []
    for altimeter, name in enumerate(ALTIMETERS[:3]):
        live = [np.abs(live_errors_m(TABLE_1, log, name.lower())).mean() for log in logs]
        lines.append([name, spread(free.mean_m(altimeter)[: draws.shape[0]]), spread(live)])
    page.grid(
        "Through the estimator's `run`, sample by sample (mean error without a fault, Table 1, "
        "optimal, m)",
        [
            f"the first {draws.shape[0]} seeds",
            "as simulated above",
            "specific force, pressure and fix",
        ],
        lines,
    )

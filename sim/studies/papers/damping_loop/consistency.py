"""Paper K's Kalman filter (11)-(16), (15) as printed and corrected: does P tell the error?"""

import numpy as np

from companion.samples import Kind
from sim.studies.page import Spread, spread
from sim.studies.papers.damping_loop import mountain_road as road
from sim.studies.papers.damping_loop.mountain_road import Drive
from sim.studies.papers.damping_loop.simulation import flight_of

NEES_DRIVES = 10
"""drives on which the printed gains are held against the best"""


def bias_nees(drives: list[Drive], place: str) -> Spread:
    """Normalised error squared of (height, climb) of a filter of climb, height and the barometer's
    bias (11)-(16), with the noise of b in the row of the height, as (15) prints, or in that of
    b."""
    return spread(
        [_three_state_nees(driven, place == "as printed") for driven in drives[:NEES_DRIVES]]
    )


def _three_state_nees(driven: Drive, printed: bool) -> float:
    """Mean over one drive after the first minute, once a barometer sample; (V_z, h, b)."""
    course = flight_of(driven).course
    sigma, beta = road.BARO_WANDER_M, 1.0 / road.BARO_TIME_S
    noise = road.FORCE_SD**2 / road.IMU_HZ + road.FORCE_BIAS**2
    x, P = np.array([0.0, road.START_M, 0.0]), np.diag([1.0, 4.0, sigma**2])
    H, last_us, force, found = np.array([0.0, 1.0, 1.0]), int(course["time_us"][0]), 0.0, []
    for time_us, kind, value in zip(
        course["time_us"], course["kind"], course["value"], strict=True
    ):
        dt = (int(time_us) - last_us) * 1e-6
        last_us = int(time_us)
        F = np.array([[1.0, 0.0, 0.0], [dt, 1.0, 0.0], [0.0, 0.0, 1.0 - beta * dt]])
        x = F @ x + np.array([dt * force, 0.0, 0.0])
        walk = 2.0 * beta * sigma**2 * dt
        P = F @ P @ F.T + np.diag([noise * dt, walk if printed else 0.0, 0.0 if printed else walk])
        if kind == Kind.IMU:
            force = float(value)
        elif kind == Kind.PRESSURE:
            K = P @ H / (H @ P @ H + road.BARO_SD_M**2)
            x, P = x + K * (float(value) - H @ x), P - np.outer(K, H @ P)
            at_s = int(time_us) * 1e-6 - road.START_S
            if at_s > 60.0:
                truth = np.array(
                    [
                        np.interp(at_s, driven.time_s, driven.climb_mps),
                        np.interp(at_s, driven.time_s, driven.altitude_m),
                    ]
                )
                error = x[:2] - truth
                found.append(float(error @ np.linalg.solve(P[:2, :2], error)))
    return float(np.mean(found))

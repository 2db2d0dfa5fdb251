"""Goals that the rows of the matrix of real flights are held against."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from companion.estimators import DEFAULT_ESTIMATOR
from companion.jobs import Row
from sim.studies.goals.goals import Measured
from sim.studies.real.matrix import group

LONG_MIN = 30.0
"""flights that are shorter have too few independent errors to be compared with raw GNSS"""
ALLOWED_ABOVE = 1e-3


def own_rows(rows: Sequence[Row]) -> list[Row]:
    """Rows of the default estimator on flights that are long enough, without what is not known to
    every user."""
    return [
        row
        for row in rows
        if row["estimator"] == DEFAULT_ESTIMATOR
        and row["error"] != "own"
        and row["minutes"] >= LONG_MIN
        and not row["field_elevation"]
    ]


def mean(rows: Sequence[Row], value: Callable[[Row], float]) -> float:
    """Mean of what is known of a value; NaN of none."""
    values = np.array([value(row) for row in rows], np.float64)
    values = values[np.isfinite(values)]
    return float(np.mean(values)) if values.size else math.nan


def worst_of(rows: Sequence[Row], value: Callable[[Row], float]) -> tuple[float, str]:
    """The largest value, and whose it is."""
    if not rows:
        return math.nan, ""
    row = max(rows, key=lambda each: -math.inf if math.isnan(value(each)) else value(each))
    return value(row), _cell_name(row)


def _cell_name(row: Row) -> str:
    attitude = "attitude" if row["attitude"] else "no attitude"
    return (
        f"{row['flight']}, IMU {row['imu_hz']} Hz, {attitude}, lag {row['lag_s']:g} s taken out, "
        f"{row['error']} error, seed {row['seed']}"
    )


def ratio(row: Row) -> float:
    """RMSE over that of raw GNSS."""
    return float(row["rmse_m"] / row["raw_rmse_m"])


def _max_ratio(row: Row) -> float:
    return float(row["max_m"] / row["raw_max_m"])


def matrix_goals(rows: Sequence[Row]) -> list[Measured]:
    """The goals of the matrix without a fault; none without a long flight."""
    own = own_rows(rows)
    if not own:
        return []
    found_goals = []
    for (imu_hz,), each in group(own, "imu_hz").items():
        note = f"{len(each)} runs"
        found_goals.append(
            Measured("real-ratio", f"IMU {imu_hz} Hz", mean(each, ratio), 0.75, note=note)
        )
    worst, where = worst_of(own, ratio)
    found_goals.append(Measured("real-ratio", "worst", worst, 1.1, note=where))
    worst, where = worst_of(own, _max_ratio)
    found_goals += [
        Measured("real-max", "mean", mean(own, _max_ratio), 1.2),
        Measured("real-max", "worst", worst, 2.0, note=where),
    ]
    for (error, flight), each in group(own, "error", "flight").items():
        nees = mean(each, lambda row: row["nees"])
        seeds = len({row["seed"] for row in each})
        note = f"{seeds} errors"
        found_goals.append(Measured("real-nees", f"{flight}, {error}", nees, 1.4, 0.7, note=note))
    return found_goals + _smoothed_goals(own) + _sent_goals(own) + _takeoff_goals(rows)


def _smoothed_goals(own: Sequence[Row]) -> list[Measured]:
    known = [row for row in own if "smoothed_rmse_m" in row]
    found_goals = []
    for (error, flight), each in group(known, "error", "flight").items():
        what, note = f"{flight}, {error}", f"{len(each)} errors"
        share = mean(each, lambda row: row["smoothed_rmse_m"] / row["raw_rmse_m"])
        nees = mean(each, lambda row: row["smoothed_nees"])
        found_goals += [
            Measured("real-smoothed", what, share, 0.60, note=note),
            Measured("real-smoothed", f"{what}, NEES", nees, 1.4, 0.4, note=note),
        ]
    return found_goals


def _sent_goals(own: Sequence[Row]) -> list[Measured]:
    least, where = worst_of(own, lambda row: -row["sent_share"])
    longest, dishonest = worst_of(own, lambda row: row["ok_wrong_s"])
    sent = sum(row["sent"] for row in own)
    above = sum(row["sent_above_level"] for row in own)
    wrong = sum(row["sent_wrong"] for row in own)
    hours = sum(row["hours"] for row in own)
    exceedances = sum(row["exceedances"] for row in own)
    return [
        Measured("real-sent", "least share", -100.0 * least, None, 98.0, "%", note=where),
        Measured("real-sent", "> 50 m wrong", wrong, 0.0, note=f"of {sent}"),
        Measured("real-health", "longest", longest, 5.0, unit="s", note=dishonest),
        Measured(
            "real-level", "median", mean(own, lambda row: row["median_level_m"]), 13.0, unit="m"
        ),
        Measured(
            "real-level",
            "ALTITUDE beyond it",
            above / sent if sent else math.nan,
            ALLOWED_ABOVE,
            note=f"{above} of {sent}; {exceedances} exceedances in {hours:.0f} h",
        ),
        _cost_goal([row for row in own if row["imu_hz"] == 50 and "imu_cost_us" in row]),
    ]


def _cost_goal(fast: Sequence[Row]) -> Measured:
    """The least processor time of the runs of a flight, as other load on the machine adds to it;
    of the flight where that is largest."""
    least = [
        (min(row["imu_cost_us"] for row in each), flight)
        for (flight,), each in group(fast, "flight").items()
    ]
    cost_us, flight = max(least, default=(math.nan, ""))
    note = f"{flight}: whole loop over its IMU samples, least of its runs; depends on the machine"
    return Measured("real-cost", "IMU sample", cost_us, 4.0, unit="us", note=note)


def _takeoff_goals(rows: Sequence[Row]) -> list[Measured]:
    known = [row for row in rows if row["field_elevation"]]
    return [
        Measured(
            "real-takeoff",
            flight,
            mean(each, lambda row: row["takeoff_rmse_m"]),
            3.0,
            unit="m",
            note=f"{len(each)} runs",
        )
        for (flight,), each in group(known, "flight").items()
    ]


def rtk_goals(rows: Sequence[Row]) -> list[Measured]:
    """The goals of recordings with a receiver of their own."""
    own = [row for row in rows if row["error"] == "own" and row["estimator"] == DEFAULT_ESTIMATOR]
    found_goals = []
    for (flight,), each in group(own, "flight").items():
        worst, where = worst_of(each, ratio)
        level, _ = worst_of(each, lambda row: row["median_level_m"])
        honest = mean(each, lambda row: row["rmse_m"] / row["median_sd_m"])
        found_goals += [
            Measured("real-rtk", f"{flight}, RMSE / receiver's, worst", worst, 1.5, note=where),
            Measured("real-rtk", f"{flight}, RMSE / spread", honest, 2.0, 0.5),
            Measured("real-rtk", f"{flight}, level, worst", level, 0.5, unit="m"),
        ]
    return found_goals

"""Section ``protection``: is the level exceeded as often as it says, and is no sensor excluded
without a reason."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from companion.estimators import DEFAULT_ESTIMATOR, ESTIMATORS, run_log
from companion.estimators.vertical_bank.settings import VerticalBankSettings, crossing_sigma
from companion.evaluation.compare import SETTLE_S
from companion.evaluation.detection import false_alarms
from companion.evaluation.integrity import (
    ALERT_LIMIT_M,
    EXCEEDANCE_APART_S,
    Regions,
    count_exceedances,
    coverage,
    poisson_interval,
    protection,
    regions,
)
from companion.evaluation.metrics import Array, truth_at
from companion.evaluation.samples import samples_of
from companion.jobs import results
from companion.plots.stanford import draw_stanford
from companion.plots.style import BOUND, FUSED, OTHER
from companion.samples import Kind, Rows
from companion.settings import CompanionSettings
from sim.scenario import load_scenario
from sim.studies.goals import Context
from sim.studies.goals.goals import Measured
from sim.studies.goals.section import SectionPage
from sim.studies.goals.sensor_level import fly, hour
from sim.studies.page import Value
from sim.studies.runs import flown

Row = dict[str, Any]
ESTIMATOR = DEFAULT_ESTIMATOR
RISKS = (1e-1, 1e-2, 1e-3)
"""integrity risks an hour that are judged"""
RARE_RISK = 1e-5
"""which no run of bearable length can judge"""
HOURS_A_JOB = 25
FIRST_SEED = 1000
"""other hours than the tests'"""
THINNED = 50
"""one sample in so many goes into the Stanford diagram"""
TAIL_SIGMA: Array = np.arange(1.0, 6.01, 0.1)
FLIGHTS_PER_1000 = 4
"""seeds of each scenario when a thousand hours are asked for: 20 h"""
HEALTHY = (
    "calm-circuit", "weather-change", "warm-front-cruise", "hour-long-cruise",
    "low-level-qnh-drift", "metar-day", "mountain-wave", "inversion-approach", "hot-and-high",
    "cold-front-descent", "cold-start", "gusty-shake", "best-sensors",
)  # fmt: skip
"""scenarios without faults, whose receivers report their true accuracy"""
WRONG = ("cheap-sensors", "static-port-error")
"""no fault begins, but a sensor is wrong by itself (a receiver that is 12 m off and reports 1.2, a
static port whose error changes by 4 m with every change of speed): shown apart, as an exclusion is
no false alarm there"""
RECORDED = ("jsbsim_A", "jsbsim_B")
_ORIGINS = {
    "sensors": "sensor level",
    "flights": "JSBSim",
    "wrong": "a sensor wrong by itself",
    "recorded": "recorded",
}


class Job(NamedTuple):
    """Hours at sensor level from a seed on, a scenario and seed to be flown, or a recorded
    flight."""

    origin: str
    seed: int = 0
    hours: int = 0
    scenario: str = ""
    log: Path | None = None


def evaluate(context: Context) -> SectionPage:
    """Fly hours at sensor level, hours of JSBSim, and look at recorded flights."""
    page = SectionPage("protection", context)
    done = context.run(work, _jobs(context))
    rows = [row for found in results(done) for row in found]
    page.text(
        "The protection level is to be exceeded at the integrity risk that is configured "
        "(`integrity_risk_probability`, an hour). An exceedance is counted once: it begins where "
        f"the absolute error is above the level, and what begins less than {EXCEEDANCE_APART_S:g} "
        "s after the last sample above it (the correlation time of the slow GNSS error) is the "
        "same one. The first minute of a flight does not count. Intervals are exact 95 % Poisson "
        "intervals; a rate is held against the largest count whose interval still contains what "
        "is allocated, and against a tenth of that where the time flown can tell it from nothing. "
        f"{' and '.join(WRONG)} have no fault that begins, but a sensor that is wrong by itself, "
        "unknown to the estimator: they are shown, and not counted among the healthy flights."
    )
    for origin in ("sensors", "flights"):
        members = [row for row in rows if row["origin"] == origin]
        page.measured(*_rate_goals(origin, members), _alarm_goal(origin, members))
    page.measured(*_median_goals([row for row in rows if row["origin"] == "recorded"]))
    _summary(page, rows)
    _tail(page, rows)
    _stanford(page, rows)
    _alarms(page, rows)
    page.failures(done)
    return page


def _jobs(context: Context) -> list[Job]:
    hours = context.seeds
    seeds = range(1, max(1, math.ceil(FLIGHTS_PER_1000 * hours / 1000)) + 1)
    jobs = [Job("flights", seed, scenario=name) for name in HEALTHY for seed in seeds]
    jobs += [Job("wrong", seed, scenario=name) for name in WRONG for seed in seeds]
    jobs += [Job("recorded", log=log) for log in context.recorded(RECORDED).values()]
    starts = range(0, hours, HOURS_A_JOB)
    return jobs + [
        Job("sensors", FIRST_SEED + first, min(HOURS_A_JOB, hours - first)) for first in starts
    ]


# Measuring


def work(job: Job) -> list[Row]:
    """Do one job; runs in a worker. A row for each flight."""
    if job.hours:
        return [_sensor_hour(seed) for seed in range(job.seed, job.seed + job.hours)]
    if job.log is not None:
        return [_logged(job, job.log, job.log.stem)]
    with flown(load_scenario(job.scenario), job.seed) as (log, _):
        return [_logged(job, log, f"{job.scenario} {job.seed}")]


def _settings(risk: float) -> VerticalBankSettings:
    return VerticalBankSettings(integrity_risk_probability=risk)


def _sensor_hour(seed: int) -> Row:
    made, found = hour(seed), {}
    for risk in (*RISKS, RARE_RISK):
        found[risk] = fly(made, _settings(risk))
    return {"origin": "sensors", "flight": f"hour {seed}"} | _measure(found)


def _logged(job: Job, path: Path, name: str) -> Row:
    log = samples_of(path, CompanionSettings())
    chosen = np.asarray(log.tables.order["kind"]) == Kind.PRESSURE
    truth_us, truth_m = (
        np.asarray(log.truth[each], np.float64) for each in ("time_us", "altitude_amsl_m")
    )
    found = {}
    for risk in (*RISKS, RARE_RISK):
        estimates = run_log(ESTIMATORS[ESTIMATOR], log, _settings(risk))[0][chosen]
        times_us = estimates["time_us"].astype(np.float64)
        error = estimates["altitude_amsl_m"] - truth_at(times_us, truth_us, truth_m)
        found[risk] = estimates, error, (times_us - float(log.first_us)) * 1e-6
    return {"origin": job.origin, "flight": name} | _measure(found)


def _measure(found: dict[float, tuple[Rows, Array, Array]]) -> Row:
    """Results of one flight: (estimates, errors, seconds) by risk."""
    row: Row = {}
    for risk, (estimates, error, elapsed_s) in found.items():
        late = elapsed_s > SETTLE_S
        level = estimates["protection_level_m"][late]
        judged = protection(elapsed_s[late], error[late], level)
        row[f"exceedances {risk:g}"] = judged.exceedances if judged is not None else 0
        row[f"exceeded {risk:g}"] = judged.exceeded_share if judged is not None else 0.0
        row[f"median {risk:g}"] = judged.median_level_m if judged is not None else math.nan
        row["hours"] = judged.hours if judged is not None else 0.0
    estimates, error, elapsed_s = found[RISKS[-1]]
    late = elapsed_s > SETTLE_S
    error, elapsed_s, estimates = error[late], elapsed_s[late], estimates[late]
    normal = np.abs(error / estimates["altitude_sd_m"])
    row["tail"] = [count_exceedances(elapsed_s[normal > k]) for k in TAIL_SIGMA]
    row["coverage"] = coverage(error, estimates["altitude_sd_m"])
    row["worst"] = float(np.nanmax(normal, initial=0.0))
    row["stanford"] = np.array([np.abs(error), estimates["protection_level_m"]])[:, ::THINNED]
    faulty = estimates["faulty"].astype(np.int64)
    row["alarms"] = false_alarms(elapsed_s, faulty)
    begins = np.flatnonzero(np.diff(faulty, prepend=0) * (faulty > 0))
    row["excluded"] = [(float(elapsed_s[k]), int(faulty[k])) for k in begins]
    return row


# Judging


def _hours(rows: Sequence[Row]) -> float:
    return float(sum(row["hours"] for row in rows))


def _most(expected: float) -> int:
    """The largest count whose interval still holds what was expected."""
    count = math.ceil(expected)
    while poisson_interval(count + 1)[0] <= expected:
        count += 1
    return count


def _rate_goals(origin: str, rows: Sequence[Row]) -> list[Measured]:
    hours, goals = _hours(rows), []
    for risk in RISKS:
        what = f"{_ORIGINS[origin]}, risk {risk:g} an hour"
        if not hours:
            goals.append(Measured("protection", what))
            continue
        count, expected = sum(row[f"exceedances {risk:g}"] for row in rows), risk * hours
        low, high = (bound / hours for bound in poisson_interval(count))
        tells = poisson_interval(0)[1] < expected
        goals.append(
            Measured(
                "protection", what, count / hours, at_most=_most(expected) / hours,
                at_least=0.1 * risk if tells else None, unit="/h",
                shown=f"{count / hours:.2g} [{low:.2g}, {high:.2g}]",
                note=f"{count} in {hours:.0f} h, {expected:.3g} allocated",
            )
        )  # fmt: skip
    return goals


def _median_goals(rows: Sequence[Row]) -> list[Measured]:
    medians = {row["flight"]: row[f"median {RISKS[-1]:g}"] for row in rows}
    return [
        Measured(
            "protection", f"{name}, median level at 1e-3", medians.get(name), at_most=25.0, unit="m"
        )
        for name in RECORDED
    ]


def _alarm_goal(origin: str, rows: Sequence[Row]) -> Measured:
    alarms = float(sum(row["alarms"] for row in rows))
    return Measured(
        "false-alarms", f"{_ORIGINS[origin]}, {_hours(rows):.0f} h", alarms, at_most=0.0
    )


# Showing


def _summary(page: SectionPage, rows: Sequence[Row]) -> None:
    lines: list[list[Value]] = []
    for origin, label in _ORIGINS.items():
        members = [row for row in rows if row["origin"] == origin]
        for name in dict.fromkeys(_group(row) for row in members):
            flights = [row for row in members if _group(row) == name]
            within = np.average(
                [[each["coverage"].within_1, each["coverage"].within_2, each["coverage"].within_3,
                  each["coverage"].nees] for each in flights], axis=0,
                  weights=[each["hours"] for each in flights],
            )  # fmt: skip
            lines.append(
                [
                    f"{label}: {name}" if name else label,
                    f"{_hours(flights):.1f}",
                    *(
                        sum(row[f"exceedances {risk:g}"] for row in flights)
                        for risk in (*RISKS, RARE_RISK)
                    ),
                    f"{np.median([row[f'median {RISKS[-1]:g}'] for row in flights]):.1f}",
                    ", ".join(f"{100 * share:.1f}" for share in within[:3]),
                    f"{within[3]:.2f}",
                    f"{max(row['worst'] for row in flights):.1f}",
                    sum(row["alarms"] for row in flights),
                ]
            )
    head = ["flights", "hours", *(f"at {risk:g}" for risk in (*RISKS, RARE_RISK)),
            "median level at 1e-3 (m)",
            "within 1, 2, 3 sd (%)", "NEES", "worst error (sd)", "exclusions"]  # fmt: skip
    page.grid("Exceedances of the level at each integrity risk", head, lines)


def _group(row: Row) -> str:
    return "" if row["origin"] == "sensors" else row["flight"].rsplit(" ", 1)[0]


def _tail(page: SectionPage, rows: Sequence[Row]) -> None:
    """Rate of exceedances beyond k sigma, against what the level's formula allocates."""
    time_s = VerticalBankSettings().gnss_time_s
    rates = 10.0 ** np.arange(-7.0, 0.0, 0.1)
    caption = (
        "Exceedances of k estimated standard deviations, an hour, and the rate that the "
        "level's formula gives for that k. The level at 1e-5 an hour is 5.6 sigma: its rate can "
        "only be guessed by going on with the curve."
    )
    with page.figure("tail", caption) as axes:
        axes[0].plot(
            [crossing_sigma(rate, time_s) for rate in rates], rates, color=BOUND, label="allocated"
        )
        for origin, colour in (("sensors", FUSED), ("flights", OTHER)):
            members = [row for row in rows if row["origin"] == origin]
            if not members:
                continue
            counts, hours = np.sum([row["tail"] for row in members], axis=0), _hours(members)
            bounds = np.array([poisson_interval(int(count)) for count in counts]) / hours
            seen = counts > 0
            axes[0].plot(
                TAIL_SIGMA[seen],
                counts[seen] / hours,
                color=colour,
                label=f"{_ORIGINS[origin]}, {hours:.0f} h",
            )
            axes[0].fill_between(
                TAIL_SIGMA, bounds[:, 0], bounds[:, 1], color=colour, alpha=0.15, linewidth=0
            )
        for risk in (*RISKS, RARE_RISK):
            axes[0].plot(crossing_sigma(risk, time_s), risk, "o", color=BOUND, markersize=4)
        axes[0].set(
            yscale="log",
            xlabel="k (sigma)",
            ylabel="exceedances an hour",
            ylim=(1e-6, 30.0),
            xlim=(1.0, 6.0),
        )
        axes[0].legend()


def _stanford(page: SectionPage, rows: Sequence[Row]) -> None:
    caption = (
        f"Stanford diagrams of the level at 1e-3 an hour, alert limit {ALERT_LIMIT_M:g} m "
        "(colours are numbers of samples, logarithmic): sensor level left, JSBSim right."
    )
    found: list[tuple[str, Regions]] = []
    with page.figure("stanford", caption, columns=2, panel_in=3.8) as axes:
        for panel, origin in zip(axes, ("sensors", "flights"), strict=True):
            parts = [row["stanford"] for row in rows if row["origin"] == origin]
            if parts:
                error, level = np.concatenate(parts, axis=1)
                draw_stanford(panel, error, level)
                found.append((_ORIGINS[origin], regions(error, level)))
            panel.set_title(_ORIGINS[origin])
    page.grid(
        "Shares of time (%)",
        ["flights", "available", "unavailable", "misleading", "hazardously misleading"],
        [
            [
                name,
                *(
                    f"{100 * share:.4g}"
                    for share in (r.available, r.unavailable, r.misleading, r.hazardous)
                ),
            ]
            for name, r in found
        ],
    )


def _alarms(page: SectionPage, rows: Sequence[Row]) -> None:
    excluded: list[list[Value]] = [
        [
            f"{_ORIGINS[row['origin']]}: {row['flight']}",
            f"{time_s:.1f}",
            ("", "barometer", "GNSS", "IMU")[sensor],
        ]
        for row in rows
        for time_s, sensor in row["excluded"]
    ]
    if excluded:
        page.grid(
            f"Exclusions ({len(excluded)}), the first twenty",
            ["flight", "at (s)", "excluded"],
            excluded[:20],
        )

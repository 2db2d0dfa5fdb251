"""Section ``states``: each state of the vertical bank over one flight through weather, beside what
it should be."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.estimators import ESTIMATORS, run_log
from companion.evaluation.metrics import Array, truth_at
from companion.evaluation.samples import samples_of
from companion.kernels.atmosphere import baro_altitude_array
from companion.plots.drawing import legend_outside
from companion.plots.style import BOUND, FUSED, GNSS, OTHER, TRUTH
from companion.samples import Kind, Rows, SampleLog
from companion.settings import CompanionSettings
from sim.studies.goals import Context
from sim.studies.goals.flight_jobs import BANK
from sim.studies.goals.samples import flown
from sim.studies.goals.section import SectionPage

RECORDED, SIMULATED = "jsbsim_B", "weather-change"
DRAWN_S = 1.0
SMOOTHED_S = 60.0
WEATHER = (("calm", FUSED), ("fair", GNSS), ("stormy", OTHER))


def evaluate(context: Context) -> SectionPage:
    """Run the bank over the recorded flight, or a simulated one without ``--data``, and draw it."""
    context.progress(0.0, "the flight")
    path = context.recorded([RECORDED]).get(RECORDED)
    log = flown(SIMULATED, 1)[0] if path is None else samples_of(path, CompanionSettings())
    page = SectionPage("states", context)
    name = f"`{SIMULATED}`, seed 1" if path is None else f"`{RECORDED}`"
    page.text(
        f"The flight is {name}; the states "
        "are those of [the derivation](../vertical-bank.md). Black is the truth, as far as the "
        "simulator knows it: the barometer's error is its reading less the truth (means of "
        f"{SMOOTHED_S:g} s, since its fast part is another state), its drift rate the slope of "
        "that beyond scale times climb. Bands are twice the estimated standard deviation."
    )
    _draw(page, states_of(log))
    context.progress(1.0, "drawn")
    return page


@dataclass(frozen=True)
class States:
    """The bank's estimates, one every `DRAWN_S`, and what the simulator knows of the truth."""

    minutes: Array
    estimates: Rows
    height_m: Array
    climb_mps: Array
    baro_error_m: Array
    gnss_error_m: Array
    drift_mps: Array

    @property
    def error_m(self) -> Array:
        return np.asarray(self.estimates["altitude_amsl_m"] - self.height_m)


def states_of(log: SampleLog) -> States:
    """Run the bank over a log with truth."""
    estimates, _, _ = run_log(ESTIMATORS[BANK], log, CompanionSettings().section(BANK))
    at_baro = estimates[np.asarray(log.tables.order["kind"]) == Kind.PRESSURE]
    at_baro = at_baro[np.isfinite(at_baro["altitude_amsl_m"])]
    second = np.floor((at_baro["time_us"] - log.first_us) * 1e-6 / DRAWN_S)
    e = at_baro[np.unique(second, return_index=True)[1]]
    times_us = np.asarray(e["time_us"], np.float64)
    truth_us, truth_m, truth_mps = (
        np.asarray(log.truth[name], np.float64)
        for name in ("time_us", "altitude_amsl_m", "climb_mps")
    )
    height_m = truth_at(times_us, truth_us, truth_m)
    climb_mps = truth_at(times_us, truth_us, truth_mps)

    def sensor_error_m(kind: Kind, values_m: Array) -> Array:
        table = log[kind]
        primary = np.asarray(table["instance"]) == 0
        own_us = np.asarray(table["time_us"], np.float64)[primary]
        return smooth(truth_at(times_us, own_us, values_m[primary]) - height_m, SMOOTHED_S)

    baro_m = baro_altitude_array(log[Kind.PRESSURE]["pressure_pa"])
    gnss_m = np.asarray(log[Kind.GNSS]["altitude_amsl_m"], np.float64)
    baro_error_m = sensor_error_m(Kind.PRESSURE, baro_m)
    drift_mps = np.gradient(baro_error_m, times_us * 1e-6) - e["baro_scale"] * climb_mps
    return States(
        (times_us - log.first_us) / 60e6, e, height_m, climb_mps, baro_error_m,
        sensor_error_m(Kind.GNSS, gnss_m), smooth(drift_mps, SMOOTHED_S),
    )  # fmt: skip


def _draw(page: SectionPage, states: States) -> None:
    caption = (
        "Each state over the flight (minutes since the first sample); blue is the bank, "
        "black the truth."
    )
    with page.figure(
        "states", caption, rows=4, columns=2, panel_in=1.9, dpi=120, sharex=True
    ) as axes:
        _draw_errors(axes, states)
        _draw_sensors(axes, states)
        _draw_integrity(axes, states)


def _draw_errors(axes: Any, states: States) -> None:
    """Height and climb: errors, and twice the estimated standard deviation."""
    e, minutes = states.estimates, states.minutes
    for axis, title, error, sd in (
        (axes[0], "height h, error (m)", states.error_m, e["altitude_sd_m"]),
        (axes[1], "climb v, error (m/s)", e["climb_mps"] - states.climb_mps, e["climb_sd_mps"]),
    ):
        axis.fill_between(minutes, -2.0 * sd, 2.0 * sd, color=FUSED, alpha=0.15, linewidth=0)
        axis.plot(minutes, error, color=FUSED, linewidth=0.8)
        axis.axhline(0.0, color=TRUTH, linewidth=0.8)
        reach = 2.0 * float(np.nanmedian(sd)) + 1.5 * float(np.nanquantile(np.abs(error), 0.99))
        axis.set(title=title, ylim=(-reach, reach))


def _draw_sensors(axes: Any, states: States) -> None:
    """Slow errors of the sensors, and the scale of the atmosphere."""
    e, minutes = states.estimates, states.minutes
    for axis, title, ours, truth in (
        (axes[2], "slow barometer error o (m)", -e["baro_offset_m"], states.baro_error_m),
        (axes[3], "its drift rate r (m/s)", e["baro_rate_mps"], states.drift_mps),
        (axes[5], "slow GNSS error g (m)", e["gnss_offset_m"], states.gnss_error_m),
    ):
        axis.plot(minutes, truth, color=TRUTH, linewidth=0.8)
        axis.plot(minutes, ours, color=FUSED)
        axis.set(title=title)
    axes[4].plot(minutes, e["baro_scale"], color=FUSED)
    axes[4].set(title="scale s of the atmosphere")


def _draw_integrity(axes: Any, states: States) -> None:
    """Probabilities of the weather, and the protection level."""
    e, minutes = states.estimates, states.minutes
    for index, (name, colour) in enumerate(WEATHER):
        axes[6].plot(minutes, e["drift_probabilities"][:, index], color=colour, label=name)
    axes[6].set(title="probability of the weather", xlabel="time (min)", ylim=(0.0, 1.0))
    legend_outside(axes[6])
    axes[7].plot(minutes, e["protection_level_m"], color=BOUND, label="protection level")
    axes[7].plot(minutes, np.abs(states.error_m), color=FUSED, label="|error|")
    axes[7].set(title="protection level (m)", xlabel="time (min)", ylim=(0.0, 40.0))
    legend_outside(axes[7])


def smooth(values: Array, time_s: float) -> Array:
    """Running mean over `time_s` of values `DRAWN_S` apart; NaN is left out."""
    window = np.ones(round(time_s / DRAWN_S))
    known = np.isfinite(values)
    total = np.convolve(np.where(known, values, 0.0), window, "same")
    return np.asarray(
        total / np.maximum(np.convolve(known.astype(np.float64), window, "same"), 1.0)
    )

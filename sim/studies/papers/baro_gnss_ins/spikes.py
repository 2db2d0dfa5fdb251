"""Paper R, section IV: gates against spikes on a descent of 10 m/s."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.estimators.baro_gnss_ins import METHOD
from companion.estimators.method import run_log
from companion.kernels.atmosphere import standard_pressure_pa
from companion.plots.style import FUSED, INERTIAL, OTHER
from companion.samples import Kind, SampleLog, Verdict, sample
from sim.studies.page import Spread, generators, spread
from sim.studies.papers.baro_gnss_ins.formulas import SECOND_US, pressures_pa
from sim.studies.papers.page import Page, Row, at_most, below, holds

Array = NDArray[np.float64]
GATE_PA, SINK_MPS, SPIKE_SHARE, SPIKE_PA, NOISE_PA = 5.0, 10.0, 0.01, 60.0, 1.0
GATE_RATES_HZ = (1, 10, 20)


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


def gate_rows(descents: list[Descents]) -> list[Row]:
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


def draw_gate(page: Page) -> None:
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

"""Section ``bound``: every estimator on the papers' common scenarios, beside the posterior
Cramer-Rao bound.

The vertical bank has the scenarios' own priors here, as the bound has; beside it stands the bank as
it comes.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from companion.config import Settings
from companion.estimators import DEFAULT_ESTIMATOR, ESTIMATORS
from companion.estimators.vertical_bank.settings import VerticalBankSettings
from companion.jobs import Done
from companion.plots.style import BARO, BOUND, FUSED, GNSS, OTHER
from companion.samples import FaultySensor, Kind
from sim.studies.goals import Context
from sim.studies.goals.bound import Model, bound
from sim.studies.goals.common_scenarios import SCENARIOS, Drawn, Scenario, draw, has_fix, heights_m
from sim.studies.goals.goals import Measured
from sim.studies.goals.section import SectionPage
from sim.studies.goals.sensor_level import START_S, Array, arrange, estimates_of
from sim.studies.page import Value

MODEL = Model()
BANK, AS_IT_COMES = "vertical-bank, their priors", "vertical-bank, as it comes"
EXCLUDES = "names the barometer"
CHUNK = 5
TRAJECTORIES = 8
"""that the bound is a mean over: it depends on a seed by the scale alone"""
OTHERS_SEEDS = 40
"""seeds of what is not judged"""
BOUND_RATIO, FAULT_RATIO = 1.10, 1.15


def bank_settings(model: Model) -> VerticalBankSettings:
    """The bank with the priors of the generating model: one weather, no drift but its rate."""
    wander_mps2 = model.accel_wander_sd_mps2 * math.sqrt(2.0 / model.accel_wander_time_s)
    return VerticalBankSettings(
        accel_noise_mps2_rthz=model.accel_white_sd_mps2 * math.sqrt(model.step_s),
        accel_bias_sd_mps2=math.hypot(model.accel_bias_sd_mps2, model.accel_wander_sd_mps2),
        accel_bias_walk_mps2_rts=wander_mps2,
        offset_sd_m=model.offset_sd_m,
        offset_walk_m_rts=0.0,
        rate_sd_mps=(model.rate_sd_mps,) * 3,
        rate_time_s=(1e5,) * 3,
        fast_sd_m=model.fast_sd_m,
        gust_ratio=(1.0,) * 3,
        fast_time_s=model.fast_time_s,
        scale_sd_ratio=model.scale_sd_ratio,
        scale_walk_rts=0.0,
        port_sd_ratio=0.0,
        lift_sd_m=0.0,
        lag_sd_s=0.0,
        timing_sd_s=0.0,
        baro_sd_m=model.baro_white_sd_m,
        gnss_time_s=model.gnss_slow_time_s,
        gnss_slow_floor_m=0.0,
    )


def sources() -> dict[str, tuple[str, Settings]]:
    """Label -> (estimator, settings), in the order of the table."""
    found: dict[str, tuple[str, Settings]] = {
        name: (name, method.settings())
        for name, method in ESTIMATORS.items()
        if name != DEFAULT_ESTIMATOR
    }
    return found | {
        AS_IT_COMES: (DEFAULT_ESTIMATOR, VerticalBankSettings()),
        BANK: (DEFAULT_ESTIMATOR, bank_settings(MODEL)),
    }


def squares(key: str, seeds: Sequence[int]) -> dict[str, Array]:
    """Mean squared error (m2) of every source on scenario `key`, one a seed; NaN without any
    estimate. A pool's job."""
    found: dict[str, list[float]] = {}
    for seed in seeds:
        drawn = draw(SCENARIOS[key], seed, MODEL)
        tables = arrange(drawn.tables)
        raw = {"raw barometer": drawn.baro_m, "raw GNSS": _held(drawn.fix_m)}
        for label, values in raw.items():
            found.setdefault(label, []).append(
                _mean_square(SCENARIOS[key], drawn, drawn.elapsed_s, values)
            )
        for label, (name, settings) in sources().items():
            if label != BANK and seed > OTHERS_SEEDS:
                continue
            estimates = estimates_of(ESTIMATORS[name], settings, tables)
            at_baro = estimates[np.asarray(tables.order["kind"]) == Kind.PRESSURE]
            elapsed_s = at_baro["time_us"] * 1e-6 - START_S
            value = _mean_square(SCENARIOS[key], drawn, elapsed_s, at_baro["altitude_amsl_m"])
            found.setdefault(label, []).append(value)
            if label == BANK:
                excludes = bool((at_baro["faulty"] == FaultySensor.BAROMETER).any())
                found.setdefault(EXCLUDES, []).append(float(excludes))
    return {label: np.array(values) for label, values in found.items()}


def _held(fixes: Array) -> Array:
    """The newest fix."""
    newest = np.maximum.accumulate(np.where(np.isfinite(fixes), np.arange(fixes.size), 0))
    return np.asarray(fixes[newest])


def _mean_square(scenario: Scenario, drawn: Drawn, elapsed_s: Array, values: Any) -> float:
    start_s, end_s = scenario.within_s
    error = np.asarray(values) - np.interp(elapsed_s, drawn.elapsed_s, drawn.height_m)
    error = error[(elapsed_s >= start_s) & (elapsed_s < end_s)]
    error = error[np.isfinite(error)]
    return float(np.mean(error**2)) if error.size else math.nan


def bound_m(
    scenario: Scenario, model: Model, trajectories: int
) -> tuple[float, float, Array, Array]:
    """Bound of filter and smoother (rms, m) where errors count, and over time: elapsed (n,), sd (2,
    n)."""
    elapsed_s = np.arange(0.0, scenario.corners[-1][0], model.step_s)
    height = heights_m(scenario, elapsed_s, model.step_s)
    scale = np.array([draw(scenario, seed, model).scale for seed in range(1, trajectories + 1)])
    both = bound(
        model,
        np.repeat(height[:, None], scale.size, 1),
        scale,
        has_fix(scenario, elapsed_s, model.step_s),
    )
    variances = np.array([each.mean(axis=1) for each in both])
    start_s, end_s = scenario.within_s
    filter_m2, smoother_m2 = variances[:, (elapsed_s >= start_s) & (elapsed_s < end_s)].mean(axis=1)
    return math.sqrt(filter_m2), math.sqrt(smoother_m2), elapsed_s, np.sqrt(variances)


def interval(over: Array, under: Array | float) -> tuple[float, float, float]:
    """sqrt(mean(over) / mean(under)) and its 95 % interval by resampling the seeds, which both
    share."""
    rng = np.random.default_rng(0)
    chosen = rng.integers(0, over.size, (2000, over.size))
    below = under[chosen].mean(axis=1) if isinstance(under, np.ndarray) else under
    low, high = np.percentile(np.sqrt(over[chosen].mean(axis=1) / below), [2.5, 97.5])
    return math.sqrt(float(np.mean(over)) / float(np.mean(under))), float(low), float(high)


def evaluate(context: Context) -> SectionPage:
    """Run the seeds on a process pool, compute the bounds, fill the page."""
    jobs = [
        Chunk(key, first, min(first + CHUNK, context.seeds + 1))
        for key in SCENARIOS
        for first in range(1, context.seeds + 1, CHUNK)
    ]
    done = context.run(chunk_squares, jobs)
    found = {key: _joined(key, done) for key in SCENARIOS}
    bounds = {}
    for number, (key, scenario) in enumerate(SCENARIOS.items()):
        bounds[key] = bound_m(scenario, MODEL, min(TRAJECTORIES, context.seeds))
        context.progress((number + 1) / len(SCENARIOS), f"bound of {key}")
    page = _page(context, found, bounds)
    page.failures(done)
    return page


class Chunk(NamedTuple):
    """Seeds of one scenario, from `first` to before `end`."""

    key: str
    first: int
    end: int


def chunk_squares(chunk: Chunk) -> dict[str, Array]:
    """`squares` of the seeds of a chunk; runs in a worker."""
    return squares(chunk.key, list(range(chunk.first, chunk.end)))


def _joined(key: str, done: Sequence[Done[Chunk, dict[str, Array]]]) -> dict[str, Array]:
    """The squares of all seeds of a scenario, by label; a label may be known for the first only."""
    chunks = [each.result for each in done if each.job.key == key and each.result is not None]
    labels = dict.fromkeys(label for chunk in chunks for label in chunk)
    return {
        label: np.concatenate([chunk[label] for chunk in chunks if label in chunk])
        for label in labels
    }


def _page(
    context: Context,
    found: dict[str, dict[str, Array]],
    bounds: dict[str, tuple[float, float, Array, Array]],
) -> SectionPage:
    page = SectionPage("bound", context)
    page.measured(*_judged(found, bounds))
    page.text(_ABOUT)
    page.text("\n".join(f"- {scenario.key}: {scenario.title}" for scenario in SCENARIOS.values()))
    rows: list[list[Value]] = [
        [label, *(_rms(found[key][label]) for key in SCENARIOS)]
        for label in found["S1"]
        if label != EXCLUDES
    ]
    rows += [
        [f"bound, {name}", *(f"{bounds[key][i]:.2f}" for key in SCENARIOS)]
        for i, name in enumerate(("filter", "smoother"))
    ]
    rows.append(
        [
            f"{EXCLUDES}, % of flights",
            *(f"{100.0 * np.mean(found[key][EXCLUDES]):.0f}" for key in SCENARIOS),
        ]
    )
    title = (
        f"RMSE in m over {context.seeds} seeds (those not judged: "
        f"{min(context.seeds, OTHERS_SEEDS)})"
    )
    page.grid(title, ["source", *SCENARIOS], rows)
    _figure(page, bounds)
    return page


def _judged(
    found: dict[str, dict[str, Array]], bounds: dict[str, tuple[float, float, Array, Array]]
) -> list[Measured]:
    rows = []
    for key, scenario in SCENARIOS.items():
        ours = found[key][BANK]
        faulty = scenario.fault not in ("", "outage")
        ratio, low, high = interval(ours, found["S2"][BANK] if faulty else bounds[key][0] ** 2)
        rows.append(
            Measured(
                "bound",
                f"{key}, ratio to {'fault-free' if faulty else 'bound'}",
                ratio,
                at_most=FAULT_RATIO if faulty else BOUND_RATIO,
                shown=f"{ratio:.3f} [{low:.3f}, {high:.3f}]",
                note=f"RMSE {_rms(ours)} m, bound {bounds[key][0]:.2f} m, {ours.size} seeds",
            )
        )
    return rows


def _rms(squared: Array) -> str:
    return f"{math.sqrt(float(np.mean(squared))):.3g}"


def _figure(page: SectionPage, bounds: dict[str, tuple[float, float, Array, Array]]) -> None:
    with page.figure(
        "over-time", "Bound over time of filter (solid) and smoother (dashed)."
    ) as axes:
        for key, color in zip(
            ("S1", "S2", "S3", "S4", "S5"), (BARO, GNSS, OTHER, BOUND, FUSED), strict=True
        ):
            _, _, elapsed_s, sd_m = bounds[key]
            axes[0].plot(elapsed_s / 60.0, sd_m[0], color=color, label=key)
            axes[0].plot(elapsed_s / 60.0, sd_m[1], "--", color=color)
        axes[0].set(
            xlabel="time (min)",
            ylabel="standard deviation (m)",
            title="Bound of height (m)",
            ylim=(0.0, 6.0),
            xlim=(0, 30),
        )
        axes[0].legend(ncols=5)


_ABOUT = """The papers' common scenarios, drawn from the model whose posterior Cramer-Rao bound is
known (`sim/evaluation/bound.py`): fixes 1 Hz with 2 m white and 4 m / 120 s Gauss-Markov error;
barometer 5 Hz with 0.3 m white and 0.5 m / 60 s; accelerometer 0.03 m/s2 white at 5 Hz, bias 0.05,
0.01 m/s2 / 100 s; sea-level pressure known to 0.5 hPa at the start and drifting with 2 hPa an
hour, air off by 10 K (both one sigma). The bound is a mean over the prior and holds for nobody's
single flight. Errors count after the first minute, in S5 within the outage. Other estimators are
as they come. S6 to S8 are held against S2, the same seeds without the fault. "Names the barometer"
is in how many flights the bank excludes the healthy barometer of S1 to S5."""

"""Paper R: Roysdon, Farrell, against `companion.estimators.baro_gnss_ins.steps`.

The note prints formulas and recommendations, no simulation. Its formulas are compared with the
standard atmosphere; its recommendations are tried on descents, climbs and an inertial flight that
are made here:

- the spike gate on a descent of 10 m/s with 1 Pa of noise and 1 % of spikes;
- barometer bias and scale factor (15)-(16) in level flight and in a climb, 3 m GNSS and 1 m
  barometer once a second;
- a flight with a five-minute GNSS outage, with and without the barometer.

Whatever the estimator has an input for goes through it as rows that a vehicle would send
(`run_log`).
"""

from pathlib import Path

from sim.studies.page import generators
from sim.studies.papers import Progress
from sim.studies.papers.baro_gnss_ins.formulas import (
    altitude_rows,
    cubic_rows,
    draw_cubic,
    kollsman_rows,
)
from sim.studies.papers.baro_gnss_ins.outage import (
    DRIFTS_HPA_PER_H,
    STORM_WALK_M_RTS,
    Outage,
    draw_outage,
    drift_rows,
    in_weather,
    outage_rows,
    storm_row,
)
from sim.studies.papers.baro_gnss_ins.spikes import GATE_RATES_HZ, Descents, draw_gate, gate_rows
from sim.studies.papers.baro_gnss_ins.states import (
    CLIMB_M,
    LEVEL_M,
    Profile,
    draw_states,
    state_rows,
)
from sim.studies.papers.page import Page


def reproduce(seeds: int, out: Path | None, progress: Progress) -> Page:
    """The page of paper R."""
    page = Page("R", seeds, out)
    page.text(
        "A technical note without a simulation of its own: formulas for pressure altitude, a "
        "rejection of spikes, and the barometer as a measurement of a GNSS/INS extended Kalman "
        "filter, with a bias and a scale factor. The formulas are held against the standard "
        "atmosphere, the rest is tried on flights made for it. Receiver clock bias and drift, two "
        "of the note's twenty states, need pseudoranges and are absent from ours."
    )
    page.table("Pressure, density, altitude (sections II to IV)", altitude_rows())
    page.table("The cubic (12) against the standard atmosphere", cubic_rows())
    draw_cubic(page)
    page.table("Kollsman correction (section V)", kollsman_rows())
    progress(0.02, "spike gate")
    descents = [Descents.of(rate_hz, min(seeds, 20)) for rate_hz in GATE_RATES_HZ]
    page.table(
        "Spikes (section IV): a descent of 10 m/s",
        gate_rows(descents),
        tuple(f"{rate_hz} Hz" for rate_hz in GATE_RATES_HZ),
    )
    draw_gate(page)
    level, climb = Profile(LEVEL_M), Profile(CLIMB_M)
    for done, generator in enumerate(generators("R", seeds), start=1):
        level.fly(generator)
        climb.fly(generator)
        progress(0.05 + 0.25 * done / seeds, "bias and scale factor")
    page.table("Bias and scale factor (15), (16)", state_rows(level, climb))
    draw_states(page, level, climb)
    outage = Outage()
    for done, generator in enumerate(generators("R", seeds), start=1):
        outage.fly(generator)
        progress(0.3 + 0.55 * done / seeds, "GNSS outage")
    drifting = {0.0: outage}
    for hpa_per_h in DRIFTS_HPA_PER_H:
        progress(0.85, f"weather, {hpa_per_h:g} hPa/h")
        drifting[hpa_per_h] = in_weather(seeds, hpa_per_h)
    stormy = in_weather(seeds, DRIFTS_HPA_PER_H[-1], STORM_WALK_M_RTS)
    page.table(
        "The vertical channel (section VI): five minutes without GNSS",
        [*outage_rows(outage), *drift_rows(drifting), storm_row(stormy)],
    )
    draw_outage(page, outage)
    return page

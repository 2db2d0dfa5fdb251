"""Faults tried on branches of a flight."""

import numpy as np
import pytest

from companion.pipeline import Pipeline
from companion.samples import FaultySensor, Kind, Packet, Verdict
from companion.settings import CompanionSettings
from sim.studies.goals.attribution import CASES, Seen, Watch, _judged, try_faults
from tests.vehicle import standing

SETTINGS = CompanionSettings.model_validate({"estimator": "vertical-bank"})
PACKETS = standing(60.0, 90.0)


def heard(pipeline: Pipeline, packets: list[Packet]) -> Seen:
    watch = Watch()
    watch.pipeline = pipeline if not pipeline.heard else pipeline.branch(watch)
    watch.pipeline.observe(watch)
    for packet in packets:
        watch.pipeline.feed(packet)
    return watch.seen()


def test_a_branch_goes_on_as_its_pipeline_would_and_leaves_it_alone() -> None:
    half = len(PACKETS) // 2
    whole = heard(Pipeline(SETTINGS, datagrams=True), PACKETS)
    pipeline = Pipeline(SETTINGS, datagrams=True)
    for packet in PACKETS[:half]:
        pipeline.feed(packet)
    first, second = heard(pipeline, PACKETS[half:]), heard(pipeline, PACKETS[half:])
    size = first.altitude_m.size
    assert size > 100
    np.testing.assert_array_equal(first.altitude_m, whole.altitude_m[-size:])
    np.testing.assert_array_equal(second.altitude_m, first.altitude_m)
    assert pipeline.now_us < whole.now_us[-1]


def seen(faulty: list[int], sd_m: list[float], verdicts: list[Verdict]) -> Seen:
    """A sample a second; the estimate is 1 m too high, its level 0.5 m from the fifth on."""
    now_us = np.arange(len(faulty), dtype=np.float64) * 1e6
    kind, level = np.full(now_us.size, float(Kind.GNSS)), np.where(now_us < 5e6, 5.0, 0.5)
    truth = np.column_stack([now_us, np.full(now_us.size, 100.0), np.zeros(now_us.size)])
    values = (
        np.array(verdicts, np.float64),
        np.full(now_us.size, 100.0),
        np.full(now_us.size, 101.0),
        np.array(sd_m),
    )
    return Seen(truth, now_us, now_us, kind, *values, level, np.array(faulty, np.float64), now_us)


def test_a_case_is_judged_by_what_was_said() -> None:
    case = next(case for case in CASES if case.name == "GNSS +30 m")
    gnss, used, gated = int(FaultySensor.GNSS), Verdict.USED, Verdict.GATED
    healthy = seen([0] * 9, [2.0] * 9, [used] * 9)
    row = _judged(
        seen(
            [0, 0, 0, 0, gnss, gnss, 1, 1, 1],
            [2.0, 2.0, 2.0, 3.1, 3.1, 3.1, 3.1, 3.1, 3.1],
            [used, used, used, used, gated, gated, used, gated, gated],
        ),
        case,
        1e6,
        healthy,
    )
    assert (row["delay_s"], row["detected_s"], row["used_while_wrong"]) == (3.0, 2.0, 1)
    assert row["wrong_share"] == pytest.approx(3 / 8)
    assert (row["max_error_m"], row["misleading_s"]) == (1.0, 3.0)


@pytest.mark.long
def test_steps_on_a_simulated_flight(tmp_path) -> None:  # type: ignore[no-untyped-def]
    from sim.flight import Flight
    from sim.scenario import load_scenario

    log = tmp_path / "flight.tlog"
    Flight(load_scenario("calm-circuit"), tlog=log, seed=3).run()
    chosen = [
        case for case in CASES if case.name in ("barometer +15 m", "barometer frozen", "GNSS -30 m")
    ]
    rows, flight = try_faults(log, SETTINGS, 2, chosen)
    assert flight["false_alarms"] == 0
    assert flight["interval_s"] == pytest.approx(
        0.1, abs=0.011
    )  # between new values: every second one is a repeat
    assert len(rows) == 6
    for row in rows:
        assert row["delay_s"] <= 1.5
        assert row["wrong_share"] == 0.0
        assert row["used_while_wrong"] == 0 or row["sensor"] == "BAROMETER"

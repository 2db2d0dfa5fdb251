"""Each sentence of the verdict follows from the figures: who was wrong, when, and what to do."""

import math
from typing import Any

import pytest

from companion.replay.verdict import badness, verdict


def summary(**changes: Any) -> dict[str, Any]:
    """A session in which nothing was wrong."""
    found: dict[str, Any] = {
        "autopilot": "ArduPilot",
        "duration_s": 2400.0,
        "notes": [],
        "samples": {"pressure": {"used": 9000}, "gnss": {"used": 1000}},
        "health": {"at_end": "OK", "reason": "", "first_s": 1.0, "lost": []},
        "at_rest": None,
        "unreadable": 0.0,
        "altitude": {"estimates": 1000, "median_sd_m": 1.05},
        "exclusions": [],
        "suspicions": [],
        "parting": {},
        "gnss": {"fixes": 1000, "share_3d": 1.0, "wander_m": 1.0, "median_sd_m": 2.0},
        "barometer": barometer(1.0, 2.0),
        "own_altitude": own(0.4),
        "reference": {"kind": "smoother", "sd_m": 0.8},
        "sources": {},
    }
    return found | changes


def barometer(drift_m: float, range_m: float, compared_with: str = "height") -> dict[str, Any]:
    return {"drift_m": drift_m, "range_m": range_m, "compared_with": compared_with}


def own(above_m: float, follows: str | None = "barometer") -> dict[str, Any]:
    return {
        "above_m": above_m,
        "above_sd_m": 0.1,
        "span_s": 60.0,
        "follows": follows,
        "without_origin_s": 0.0,
    }


def excluded(**changes: Any) -> dict[str, Any]:
    span = {
        "sensor": "gnss",
        "from_s": 790.0,
        "from_utc": "2026-11-28T12:03:10.200+00:00",
        "duration_s": 80.0,
        "off_m": 31.0,
        "step_m": 29.6,
    }
    return span | changes


def test_a_good_flight_needs_two_sentences() -> None:
    found = verdict(summary())
    assert found["verdict"] == (
        "Altitude is known within 2.1 m (95 %). At the end the autopilot's altitude was 0.4 m "
        "above Kollsman's, which is within what is known: nothing to change."
    )
    assert [each["level"] for each in found["findings"]] == ["good", "good"]


def test_a_drift_is_told_with_its_time() -> None:
    found = verdict(summary(barometer=barometer(14.2, 14.6)))
    assert "The barometer drifted +14 m in 40 minutes." in found["verdict"]
    there_and_back = verdict(summary(barometer=barometer(-2.0, 38.0)))
    assert "moved through 38 m in 40 minutes and ended -2 m" in there_and_back["verdict"]


def test_without_truth_a_drift_is_one_against_gnss() -> None:
    """Either of the two may have moved."""
    found = verdict(summary(barometer=barometer(14.2, 14.6, "gnss")))
    assert "The barometer drifted +14 m against GNSS in 40 minutes." in found["verdict"]
    there_and_back = verdict(summary(barometer=barometer(-2.0, 38.0, "gnss")))
    assert "The barometer's difference to GNSS moved through 38 m" in there_and_back["verdict"]
    rest = verdict(
        summary(barometer=barometer(6.2, 6.6), at_rest={"published": 7.2, "autopilot": 0.4})
    )
    assert "Kollsman's altitude moved through 7 m while the vehicle stood" in rest["verdict"]
    assert "drifted +6 m in 40 minutes while the vehicle stood still." in rest["verdict"]


def test_an_excluded_jump_has_its_time_and_duration() -> None:
    found = verdict(summary(exclusions=[excluded()]))
    assert "GNSS jumped +30 m at 12:03:10 UTC and was excluded for 80 s." in found["verdict"]


def test_a_slow_fault_is_no_jump() -> None:
    found = verdict(summary(exclusions=[excluded(step_m=2.0, off_m=-95.0, from_utc=None)]))
    text = "GNSS moved away by up to -95 m 790 s after the start and was excluded for 80 s."
    assert text in found["verdict"]


def test_an_exclusion_of_unknown_size_is_told_without_one() -> None:
    found = verdict(summary(exclusions=[excluded(sensor="imu", off_m=math.nan, step_m=math.nan)]))
    assert "The IMU was excluded for 80 s, at 12:03:10 UTC." in found["verdict"]


def test_many_exclusions_are_one_sentence() -> None:
    found = verdict(summary(exclusions=[excluded(duration_s=10.0)] * 6))
    assert "GNSS was excluded 6 times for 60 s in all, first at 12:03:10 UTC." in found["verdict"]


def test_sensors_that_part_without_an_exclusion() -> None:
    parted = {
        "off_m": 112.0,
        "from_s": 520.0,
        "to_s": 740.0,
        "from_utc": "2026-01-01T00:08:40+00:00",
        "to_utc": "2026-01-01T00:12:20+00:00",
        "sensor": None,
    }
    doubt = verdict(summary(parting=parted))["verdict"]
    assert "one of them was wrong" in doubt
    assert "Find out which" in doubt
    assert "Change nothing because of this session alone." in doubt
    gnss = verdict(summary(parting=parted | {"sensor": "gnss"}))["verdict"]
    assert "GNSS was wrong. Look for interference" in gnss
    told = verdict(summary(parting=parted, exclusions=[excluded(from_s=600.0)]))
    assert "parted" not in told["verdict"]  # the exclusion tells it
    assert "nothing to change" in told["verdict"]


@pytest.mark.parametrize(
    ("autopilot", "follows", "above_m", "text"),
    [
        ("ArduPilot", "barometer", 14.2, "Change BARO_ALT_OFFSET by -14.2 m for this flight"),
        (
            "ArduPilot",
            None,
            -6.0,
            "If its height is the barometer's: change BARO_ALT_OFFSET by +6.0",
        ),
        ("PX4", "barometer", 10.0, "Change SENS_BARO_QNH by -1.2 hPa"),  # 8.4 m are 1 hPa
        ("ArduPilot", "gnss", 14.2, "a barometer parameter changes nothing"),
        ("ArduPilot", "barometer", -590.0, "more than weather: check its origin"),
    ],
)
def test_what_to_change(autopilot: str, follows: str | None, above_m: float, text: str) -> None:
    found = verdict(summary(autopilot=autopilot, own_altitude=own(above_m, follows)))
    assert text in found["verdict"]


def test_no_advice_from_too_little() -> None:
    short = verdict(summary(duration_s=30.0))
    assert "the estimate had no time to settle" in short["verdict"]
    assert "Too short to say whether the autopilot needs a change" in short["verdict"]
    assert "no altitude of its own" in verdict(summary(own_altitude={}))["verdict"]


def health(first_s: float | None, *lost: dict[str, Any]) -> dict[str, Any]:
    return {"at_end": "LOST", "reason": "uncertain by 99 m", "first_s": first_s, "lost": list(lost)}


def lost_for(duration_s: float, *, silent: bool = False) -> dict[str, Any]:
    return {"from_s": 50.0, "from_utc": None, "duration_s": duration_s, "silent": silent}


def test_a_session_without_any_altitude_says_why_and_what_to_do() -> None:
    gnss = {"fixes": 100, "share_3d": 0.0, "median_sd_m": math.nan, "wander_m": math.nan}
    found = verdict(summary(health=health(None), gnss=gnss))
    assert found["verdict"].startswith(
        "No altitude in all of the session: GNSS never had a 3D fix. "
    )
    assert "give air.qnh_hpa or air.field_elevation_m" in found["verdict"]
    assert found["reason"] == found["findings"][0]["text"]
    other = verdict(summary(health=health(None)))
    assert "No altitude in all of the session: uncertain by 99 m." in other["verdict"]
    nothing = verdict(summary(health=health(None), altitude={"estimates": 0}))
    assert "there is no usable barometer or GNSS height" in nothing["verdict"]


def test_an_altitude_that_begins_late_or_is_lost_is_told_with_its_time() -> None:
    gnss = summary()["gnss"] | {"first_3d_s": 21.0}
    assert "begins" not in verdict(summary(health=health(23.0), gnss=gnss))["verdict"]
    late = verdict(summary(health=health(23.0), gnss=gnss, duration_s=100.0))
    assert (
        "The altitude begins 23 s after the start of the session, as GNSS had no 3D fix for 21 s."
        in late["verdict"]
    )
    once = verdict(summary(health=health(1.0, lost_for(12.0))))
    assert "The altitude was lost for 12 s, 50 s after the start." in once["verdict"]
    silent = lost_for(12.0, silent=True)
    twice = verdict(summary(health=health(1.0, silent, silent)))
    assert "lost 2 times for 24 s in all because no sensor data came, first" in twice["verdict"]


def test_an_autopilot_without_an_origin_is_told_instead_of_a_wrong_altitude() -> None:
    found = verdict(summary(own_altitude=own(0.4) | {"without_origin_s": 80.0}))
    assert "For the first 80 s the autopilot sent its height above the start" in found["verdict"]
    assert not found["wrong"]


def test_the_gravest_finding_is_the_reason_and_the_order() -> None:
    fine, drift = summary(), summary(barometer=barometer(14.2, 14.6))
    assert verdict(drift)["reason"] == "The barometer drifted +14 m in 40 minutes."
    worst: dict[str, Any] = {"published": {"p95_m": 50.0, "max_m": 60.0, "rmse_m": 2.0}}
    wrong = drift | {"sources": worst}
    told = verdict(wrong)["reason"]
    assert told.startswith("Kollsman's altitude differed from the smoothed altitude by up to 60 m")
    assert told.endswith("The barometer drifted +14 m in 40 minutes.")
    orders = [badness(each | verdict(each)) for each in (wrong, drift, fine)]
    assert orders == sorted(orders, reverse=True)


def test_that_there_is_no_advice_is_no_reason() -> None:
    told = verdict(summary(own_altitude={}))
    assert told["verdict"].endswith("the log holds no altitude of its own.")
    assert told["reason"] == told["findings"][0]["text"]


def test_at_most_three_notes_are_sentences() -> None:
    found = verdict(summary(notes=[f"vehicle {k}/1 lost" for k in range(6)], unreadable=0.105))
    assert (
        "Vehicle 0/1 lost. Vehicle 1/1 lost. Vehicle 2/1 lost. Further notes in the tables: 3."
        in found["verdict"]
    )
    assert "10% of the file is zeros or junk." in found["verdict"]


def test_a_suspect_sensor_is_told_with_its_size() -> None:
    span = {"sensor": "barometer", "from_s": 3.0, "from_utc": None, "duration_s": 490.0}
    found = verdict(summary(suspicions=[span | {"off_m": 5310.2}]))
    assert "The barometer contradicted GNSS by +5310 m, beyond any weather" in found["verdict"]
    found = verdict(summary(suspicions=[span | {"sensor": "gnss", "off_m": -0.3}]))
    assert "GNSS contradicted the barometer beyond any weather, first 3 s" in found["verdict"]


def test_an_error_beyond_the_reported_accuracy_is_told() -> None:
    sources = {"published": {"p95_m": 4.0, "max_m": 6.0, "rmse_m": 2.0}}
    truth = {"kind": "truth", "sd_m": math.nan}
    found = verdict(summary(reference=truth, sources=sources))
    assert found["findings"][0] == {
        "level": "warning",
        "text": "Altitude was reported to be known within 2.1 m (95 %); the error was 4.0 m.",
    }


def test_a_receiver_without_any_fix() -> None:
    none = {"fixes": 100, "share_3d": 0.0, "median_sd_m": math.nan, "wander_m": math.nan}
    assert "GNSS never had a 3D fix." in verdict(summary(gnss=none))["verdict"]


def test_a_receiver_without_any_usable_height_is_the_reason() -> None:
    note = "GNSS receiver 1 sends heights of exactly 0 with a fix: they are not used"
    none = {"pressure": {"used": 900}, "gnss": {"invalid": 400}}
    found = verdict(summary(health=health(None), samples=none, notes=[note]))
    assert found["reason"] == f"No altitude in all of the session: {note}."
    assert found["verdict"].count("exactly 0") == 1
    assert "give air.qnh_hpa" in found["verdict"]


def test_an_autopilot_that_never_had_an_origin() -> None:
    never = own(math.nan) | {"without_origin_s": 2400.0, "span_s": 0.0}
    text = verdict(summary(own_altitude=never))["verdict"]
    assert "In all of the session the autopilot sent its height above the start" in text


def test_a_session_without_a_barometer_says_so() -> None:
    unknown = {"drift_m": None, "range_m": None, "compared_with": "gnss"}
    found = verdict(summary(samples={"gnss": {"used": 1000}}, barometer=unknown))
    assert "There was no barometer." in found["verdict"]

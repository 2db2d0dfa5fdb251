"""``/metrics``: a snapshot in the exposition format of Prometheus.

Units are Prometheus' base units (metres, pascals, seconds, ratios). A value that is unknown is left
out, so that an alert on its absence works.
"""

from collections.abc import Iterator, Mapping
from typing import Any

from prometheus_client import CollectorRegistry
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4, generate_latest
from prometheus_client.registry import Collector

from companion.health import Health
from companion.web.board import Board

CONTENT_TYPE = CONTENT_TYPE_PLAIN_0_0_4
_GAUGES = {
    # name: (key of "now", factor, meaning)
    "kollsman_altitude_amsl_meters": ("altitude_m", 1.0, "Estimated altitude above mean sea level"),
    "kollsman_altitude_sd_meters": ("altitude_sd_m", 1.0, "Standard deviation of the altitude"),
    "kollsman_protection_level_meters": (
        "level_m",
        1.0,
        "Error of the altitude that is exceeded only at the configured integrity risk",
    ),
    "kollsman_climb_meters_per_second": ("climb_mps", 1.0, "Climb rate, positive up"),
    "kollsman_height_above_takeoff_meters": ("above_takeoff_m", 1.0, "Height above take-off"),
    "kollsman_barometer_drift_meters_per_second": (
        "baro_rate_mps",
        1.0,
        "Drift of the barometer's error at constant height",
    ),
    "kollsman_gnss_offset_meters": ("gnss_offset_m", 1.0, "Slow error of the GNSS height"),
    "kollsman_gnss_altitude_meters": ("gnss_m", 1.0, "Altitude of the last GNSS fix"),
    "kollsman_autopilot_altitude_meters": ("autopilot_m", 1.0, "The autopilot's own altitude"),
}
_ALTITUDES = {
    # name: (key of "altitude", factor, meaning)
    "kollsman_qnh_pascals": ("qnh_hpa", 100.0, "Altimeter setting (QNH) estimate"),
    "kollsman_qnh_sd_pascals": ("qnh_sd_hpa", 100.0, "Standard deviation of the QNH"),
    "kollsman_barometer_offset_meters": (
        "baro_offset_m",
        1.0,
        "Altitude minus that of the barometer in a standard atmosphere",
    ),
}


class BoardCollector(Collector):
    """The newest snapshot of a board as metrics."""

    def __init__(self, board: Board) -> None:
        self._board = board

    def collect(self) -> Iterator[Metric]:
        snapshot = self._board.newest
        if snapshot is None:
            return
        session = snapshot.document["sessions"][0]
        info = GaugeMetricFamily(
            "kollsman_info",
            "Version, estimator and vehicle; always 1",
            labels=["version", "estimator", "vehicle", "autopilot"],
        )
        names = [session["estimator"], session["vehicle"] or "", session["autopilot"] or ""]
        info.add_metric([snapshot.document["kollsman"], *names], 1.0)
        yield info
        age_s = self._board.age_s
        yield GaugeMetricFamily(
            "kollsman_snapshot_age_seconds", "Time since the estimator's loop reported", age_s
        )
        yield GaugeMetricFamily(
            "kollsman_uptime_seconds", "Time since the service started", session["duration_s"]
        )
        yield from _gauges(_GAUGES, session["now"])
        yield from _gauges(_ALTITUDES, session["altitude"])
        yield _state(
            "kollsman_health", "health", session["health"]["at_end"], list(Health.__members__)
        )
        yield _state(
            "kollsman_excluded",
            "excluded sensor",
            session["now"]["excluded"],
            ["barometer", "gnss", "imu"],
        )
        yield from _sensors(session)
        yield from _link(session)
        yield from _feedback(session["feedback"])


def _gauges(
    table: Mapping[str, tuple[str, float, str]], values: Mapping[str, Any]
) -> Iterator[Metric]:
    for name, (key, factor, meaning) in table.items():
        if values.get(key) is not None:
            yield GaugeMetricFamily(name, meaning, values[key] * factor)


def _state(name: str, what: str, now: str | None, states: list[str]) -> Metric:
    metric = GaugeMetricFamily(name, f"1 for the {what} now, 0 for the others", labels=["state"])
    for state in states:
        metric.add_metric([state], float(state == now))
    return metric


def _sensors(session: Mapping[str, Any]) -> Iterator[Metric]:
    samples = CounterMetricFamily(
        "kollsman_samples", "Samples by sensor and verdict", labels=["sensor", "verdict"]
    )
    for sensor, verdicts in session["samples"].items():
        for verdict, count in verdicts.items():
            samples.add_metric([sensor, verdict], count)
    rates = GaugeMetricFamily("kollsman_sensor_hertz", "Rate of samples", labels=["sensor"])
    ages = GaugeMetricFamily(
        "kollsman_sensor_age_seconds", "Time since the last sample", labels=["sensor"]
    )
    for sensor, found in session["sensors"].items():
        for metric, key in ((rates, "rate_hz"), (ages, "age_s")):
            if found[key] is not None:
                metric.add_metric([sensor], found[key])
    yield from (samples, rates, ages)


def _link(session: Mapping[str, Any]) -> Iterator[Metric]:
    link = session["link"]
    yield CounterMetricFamily("kollsman_frames_heard", "MAVLink frames heard", link["frames"])
    yield CounterMetricFamily("kollsman_frames_sent", "MAVLink frames sent", link["sent"])
    yield CounterMetricFamily(
        "kollsman_altitudes_published",
        "ALTITUDE messages sent",
        session["altitude"]["published"],
    )
    lost = CounterMetricFamily(
        "kollsman_frames_lost", "Frames missing by sequence number", labels=["link", "sender"]
    )
    for url, senders in link["traffic"].items():
        for sender, found in senders.items():
            lost.add_metric([url, sender], found["lost"])
    rejected = CounterMetricFamily(
        "kollsman_input_rejected",
        "Bad input: bytes of junk, frames of other causes",
        labels=["cause"],
    )
    for cause, count in link["rejected"].items():
        rejected.add_metric([cause], count)
    left_out = CounterMetricFamily(
        "kollsman_readings_left_out", "Readings that became no sample", labels=["cause"]
    )
    for cause, count in session["left_out"].items():
        left_out.add_metric([cause], count)
    yield from (lost, rejected, left_out)


def _feedback(feedback: Mapping[str, Any]) -> Iterator[Metric]:
    if feedback["mode"] == "none":
        return
    yield GaugeMetricFamily(
        "kollsman_feedback_offset_meters", "Correction that is written", feedback["offset_m"]
    )
    yield CounterMetricFamily(
        "kollsman_feedback_writes", "Writes of the parameter", feedback["writes"]
    )


def exposition(board: Board) -> bytes:
    """The metrics of the newest snapshot, as text."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(BoardCollector(board))
    return generate_latest(registry)

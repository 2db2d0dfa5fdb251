"""Examines a vehicle's telemetry, and names the autopilot parameters to set.

The companion serves the link for some seconds exactly as ``kollsman run`` does, and what was heard
is then checked rule by rule. A rule is a function ``(Case) -> Finding | None`` in `RULES`. Nothing
is written to the vehicle but the requests for message rates that ``run`` makes too.
"""

from collections.abc import Callable, Iterator

from companion.clock import Clock
from companion.doctor import connection, sensors
from companion.doctor.case import Case, Finding, Grade, autopilots
from companion.doctor.reference import reference
from companion.hearing import Hearing, Speaker
from companion.key_file import open_signing
from companion.links import Link
from companion.mavlink.codec import Message, mavlink
from companion.mavlink.identity import autopilot_name, is_autopilot
from companion.reference_link import ReferenceLink
from companion.service import Service
from companion.settings import CompanionSettings

__all__ = ["RULES", "Case", "Finding", "Grade", "examine", "report"]

POLL_S = 0.1

RULES: tuple[Callable[[Case], Finding | None], ...] = (
    connection.nothing_received,
    connection.no_mavlink,
    connection.no_autopilot,
    connection.not_followed,
    connection.several_autopilots,
    connection.signatures,
    sensors.barometer,
    sensors.gnss,
    sensors.inertial,
    reference,
    connection.refusals,
    connection.version,
    connection.vehicle_clock,
    connection.delay,
    connection.loss,
    connection.own_ids,
    connection.own_altitude,
    connection.health,
)


def examine(
    link: Link,
    settings: CompanionSettings,
    clock: Clock,
    seconds: float,
    reference_link: ReferenceLink | None = None,
) -> tuple[Case, list[Finding]]:
    """Serve `link`, and the link to the ground barometer, for some seconds, and what was found,
    worst first."""
    hearing = Hearing(link, clock)
    signing = open_signing(settings.signing)
    service = Service(hearing, settings, clock, signing=signing, reference=reference_link)
    end_us = clock.now_us() + round(seconds * 1e6)
    while clock.now_us() < end_us:
        service.turn(POLL_S)
    if hasattr(service, "stop"):
        service.stop()
    case = Case(hearing, service, _vehicle(hearing, service), clock.now_us())
    found = [finding for rule in RULES if (finding := rule(case)) is not None]
    return case, sorted(found, key=lambda finding: -finding.grade)


def _vehicle(hearing: Hearing, service: Service) -> Speaker | None:
    if service.pipeline.identity.vehicle is not None:
        return service.pipeline.identity.vehicle
    return next(iter(autopilots(hearing)), None)


def report(case: Case, findings: list[Finding]) -> Iterator[str]:
    """The lines of the report."""
    hearing = case.hearing
    junk = {str(cause): count for cause, count in hearing.decoder.counters.items() if count}
    yield (
        f"{hearing.url}: {hearing.statistics.received_bytes} bytes in {hearing.duration_s():.0f} "
        f"s, {hearing.decoder.frames} MAVLink frames, bad input: {junk or 'none'}"
    )
    for (system, component), sender in sorted(hearing.senders.items()):
        beat = sender.heartbeat
        kind = autopilot_name(beat.autopilot) if beat is not None and is_autopilot(beat) else ""
        role = f", autopilot {kind}" if kind else ""
        yield f"{system}/{component}{role}: MAVLink {sender.version}, {sender.lost} frames lost"
        for number, stream in sorted(sender.streams.items()):
            rate_hz = hearing.rate_hz((system, component), number)
            name = mavlink.mavlink_map[number].msgname
            yield f"    {rate_hz:6.1f} Hz  {name:24s} {_shown(stream.last)}".rstrip()
    for finding in findings:
        word = {Grade.GOOD: "good ", Grade.NOTE: "note ", Grade.WRONG: "WRONG"}[finding.grade]
        yield f"{word} {finding.what}"
        if finding.cure:
            yield f"      -> {finding.cure}"


def _shown(message: Message | None) -> str:
    """The values that matter, with units."""
    if message is None:
        return ""
    match message.get_type():
        case "SCALED_PRESSURE" | "SCALED_PRESSURE2" | "SCALED_PRESSURE3":
            return f"{message.press_abs:.2f} hPa, sensor {message.temperature * 0.01:.1f} degC"
        case "GPS_RAW_INT" | "GPS2_RAW":
            return (
                f"fix {message.fix_type}, {message.alt * 1e-3:.1f} m AMSL, v_acc "
                f"{message.v_acc * 1e-3:.1f} m, {message.satellites_visible} satellites"
            )
        case "RAW_IMU" | "SCALED_IMU":
            return f"z {message.zacc} (-1000: milli-g)"
        case "HIGHRES_IMU":
            return f"z {message.zacc:.2f} m/s2, {message.abs_pressure:.2f} hPa"
        case "GLOBAL_POSITION_INT":
            return (
                f"{message.alt * 1e-3:.1f} m AMSL, {message.relative_alt * 1e-3:.1f} m above home"
            )
        case "SYSTEM_TIME":
            return f"up {message.time_boot_ms * 1e-3:.0f} s"
        case "DISTANCE_SENSOR":
            return f"{message.current_distance * 0.01:.2f} m"
    return ""

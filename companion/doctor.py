"""What is wrong with a vehicle's telemetry, in plain words, and which autopilot parameter cures it.

The companion serves the link for some seconds exactly as ``kollsman run`` does, and what was heard
is then checked rule by rule. A rule is a function ``(Case) -> Finding | None`` in `RULES`. Nothing
is written to the vehicle but the requests for message rates that ``run`` makes too.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from itertools import pairwise

from companion.clock import Clock
from companion.hearing import Hearing, Speaker
from companion.links import Link
from companion.mavlink.codec import FrameReject, Message, mavlink
from companion.mavlink.identity import autopilot_name, is_autopilot
from companion.service import Service
from companion.settings import CompanionSettings

POLL_S = 0.1
IMU_IDS = (
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU,
    mavlink.MAVLINK_MSG_ID_SCALED_IMU,
    mavlink.MAVLINK_MSG_ID_RAW_IMU,
)
PRESSURE_IDS = (
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE,
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE2,
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU,
)
GNSS_IDS = (mavlink.MAVLINK_MSG_ID_GPS_RAW_INT, mavlink.MAVLINK_MSG_ID_GPS2_RAW)
SYSTEM_TIME = mavlink.MAVLINK_MSG_ID_SYSTEM_TIME
ALTITUDE = mavlink.MAVLINK_MSG_ID_ALTITUDE
HOUR_US = 3_600_000_000


class Grade(IntEnum):
    """How bad a finding is."""

    GOOD = 0
    NOTE = 1
    WRONG = 2


@dataclass(frozen=True)
class Finding:
    """One thing found: what it is, and what to do."""

    grade: Grade
    what: str
    cure: str = ""


@dataclass(frozen=True)
class Case:
    """What the rules look at."""

    hearing: Hearing
    service: Service
    vehicle: Speaker | None
    """the sender that is the vehicle, also where the service does not follow it"""
    host_us: int

    @property
    def is_px4(self) -> bool:
        beat = self.hearing.senders[self.vehicle].heartbeat if self.vehicle else None
        return beat is not None and beat.autopilot == mavlink.MAV_AUTOPILOT_PX4

    def rate_hz(self, *message_ids: int) -> float:
        """Rate of the fastest of these messages of the vehicle."""
        if self.vehicle is None:
            return 0.0
        return max(self.hearing.rate_hz(self.vehicle, number) for number in message_ids)

    def last(self, *message_ids: int) -> Message | None:
        """The newest of the first of these messages that was heard."""
        if self.vehicle is None:
            return None
        found = (self.hearing.last(self.vehicle, number) for number in message_ids)
        return next((message for message in found if message is not None), None)

    def either(self, ardupilot: str, px4: str) -> str:
        """Advice for the autopilot at hand."""
        return px4 if self.is_px4 else ardupilot


def examine(
    link: Link, settings: CompanionSettings, clock: Clock, seconds: float
) -> tuple[Case, list[Finding]]:
    """Serve `link` for some seconds, and what was found, worst first."""
    hearing = Hearing(link, clock)
    service = Service(hearing, settings, clock)
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
    return next(iter(_autopilots(hearing)), None)


def _autopilots(hearing: Hearing) -> list[Speaker]:
    """Who says that it is an autopilot, the one with most messages first."""
    found = [
        speaker
        for speaker, sender in hearing.senders.items()
        if sender.heartbeat is not None and is_autopilot(sender.heartbeat)
    ]
    return sorted(found, key=lambda speaker: -hearing.senders[speaker].frames)


def _rates_advice(case: Case, group: str) -> str:
    return case.either(
        f"let Kollsman ask for it (streams.request), or set SRn_{group} of this port to 10 "
        "(n is the number of the MAVLink port, counted from 0)",
        "set MAV_n_MODE of this port to Onboard, or MAV_n_RATE higher",
    )


def nothing_received(case: Case) -> Finding | None:
    if case.hearing.statistics.received_bytes:
        return None
    return Finding(
        Grade.WRONG,
        f"not one byte was received on {case.hearing.url}",
        "check the cable (TX to RX), the port, and that the autopilot sends MAVLink there: "
        "ArduPilot SERIALn_PROTOCOL = 2; PX4 MAV_n_CONFIG = the port",
    )


def no_mavlink(case: Case) -> Finding | None:
    hearing = case.hearing
    if not hearing.statistics.received_bytes or hearing.decoder.frames:
        return None
    printable = sum(32 <= byte < 127 or byte in (9, 10, 13) for byte in hearing.text)
    count = hearing.statistics.received_bytes
    if printable > 0.95 * len(hearing.text):
        start = hearing.text[:40].decode("ascii", "replace").split("\n")[0].strip()
        return Finding(
            Grade.WRONG,
            f"{count} bytes of text, no MAVLink (it begins with {start!r})",
            "this port is a console or speaks NMEA: set ArduPilot SERIALn_PROTOCOL = 2, or PX4 "
            "MAV_n_CONFIG to this port",
        )
    return Finding(
        Grade.WRONG,
        f"{count} bytes, no MAVLink in them",
        "the baud rate differs: set ArduPilot SERIALn_BAUD (57 is 57600, 921 is 921600) or PX4 "
        "SER_x_BAUD, and give the same to Kollsman as DEVICE:BAUD; or the port is not MAVLink: "
        "SERIALn_PROTOCOL = 2",
    )


def no_autopilot(case: Case) -> Finding | None:
    if case.vehicle is not None or not case.hearing.decoder.frames:
        return None
    who = ", ".join(f"{system}/{component}" for system, component in case.hearing.senders)
    return Finding(
        Grade.WRONG,
        f"MAVLink of {who}, but no heartbeat of an autopilot",
        "connect to a port of the autopilot itself; behind a router, check that it forwards the "
        "autopilot; ids other than those configured: vehicle.system_id",
    )


def not_followed(case: Case) -> Finding | None:
    if case.vehicle is None or case.service.pipeline.identity.vehicle is not None:
        return None
    pilots = _autopilots(case.hearing)
    named = " and ".join(f"{system}/{component}" for system, component in pilots)
    if len(pilots) > 1:
        cure = f"choose one with vehicle.system_id, for example {pilots[0][0]}"
    elif pilots[0][0] == 0:
        cure = "give the vehicle a system id: ArduPilot SYSID_THISMAV = 1, PX4 MAV_SYS_ID = 1"
    else:
        cure = "check vehicle.system_id of the configuration"
    return Finding(Grade.WRONG, f"autopilot {named} is heard but not followed", cure)


def several_autopilots(case: Case) -> Finding | None:
    pilots = _autopilots(case.hearing)
    if len(pilots) < 2 or case.service.pipeline.identity.vehicle is None:
        return None
    named = " and ".join(f"{system}/{component}" for system, component in pilots)
    return Finding(
        Grade.NOTE,
        f"several autopilots are heard: {named}",
        "name the one to follow with vehicle.system_id; give each its own SYSID_THISMAV (ArduPilot) "
        "or MAV_SYS_ID (PX4)",
    )


def barometer(case: Case) -> Finding | None:
    message = case.last(*PRESSURE_IDS)
    rate_hz = case.rate_hz(*PRESSURE_IDS)
    if case.vehicle is None:
        return None
    if message is None or not rate_hz:
        return Finding(
            Grade.WRONG, "no barometer (SCALED_PRESSURE)", _rates_advice(case, "RAW_SENS")
        )
    pressure_hpa = getattr(message, "press_abs", getattr(message, "abs_pressure", math.nan))
    if not 10.0 < pressure_hpa < 1200.0:
        return Finding(
            Grade.WRONG,
            f"the barometer says {pressure_hpa:.1f} hPa: it does not work",
            case.either(
                "check BARO1_DEVID (0: not found), choose another with BARO_PRIMARY, look for an "
                "external one with BARO_PROBE_EXT",
                "check SYS_HAS_BARO = 1 and CAL_BAROn_PRIO",
            ),
        )
    if rate_hz < 4.0:
        return Finding(
            Grade.NOTE,
            f"the barometer comes at {rate_hz:.1f} Hz; 10 Hz or more is better",
            _rates_advice(case, "RAW_SENS"),
        )
    return Finding(Grade.GOOD, f"barometer {pressure_hpa:.1f} hPa at {rate_hz:.0f} Hz")


def gnss(case: Case) -> Finding | None:
    if case.vehicle is None:
        return None
    message = case.last(*GNSS_IDS)
    rate_hz = case.rate_hz(*GNSS_IDS)
    if message is None or not rate_hz:
        return Finding(
            Grade.WRONG,
            "no GNSS (GPS_RAW_INT)",
            _rates_advice(case, "EXT_STAT")
            + "; is a receiver set up: "
            + case.either("GPS1_TYPE = 1 (GPS_TYPE before 4.6)", "GPS_1_CONFIG"),
        )
    if message.fix_type < 3:
        return Finding(
            Grade.WRONG,
            f"GNSS without a 3D fix (fix type {message.fix_type}, "
            f"{message.satellites_visible} satellites)",
            "wait under an open sky; fix type 0 or 1 for minutes: check the receiver's cable and "
            + case.either("GPS1_TYPE (GPS_TYPE before 4.6)", "GPS_1_CONFIG"),
        )
    if not getattr(message, "v_acc", 0):
        return Finding(
            Grade.NOTE,
            f"GNSS height {message.alt * 1e-3:.1f} m AMSL without a reported accuracy; 10 m is assumed",
            "speak MAVLink 2 on this port (it carries v_acc): "
            + case.either("SERIALn_PROTOCOL = 2", "MAV_PROTO_VER = 2"),
        )
    if message.v_acc > 15_000:
        return Finding(
            Grade.NOTE,
            f"GNSS height is only good to {message.v_acc * 1e-3:.0f} m",
            "wait under an open sky; keep transmitters and USB 3 away from the antenna",
        )
    return Finding(
        Grade.GOOD,
        f"GNSS {message.alt * 1e-3:.1f} m AMSL, good to {message.v_acc * 1e-3:.1f} m, "
        f"at {rate_hz:.0f} Hz",
    )


def inertial(case: Case) -> Finding | None:
    if case.vehicle is None:
        return None
    rate_hz, message = case.rate_hz(*IMU_IDS), case.last(*IMU_IDS)
    loop = case.either(
        "SCHED_LOOP_RATE bounds what is granted (Plane: 50 Hz, at most every second loop): 40 Hz or "
        "less is granted; or set SRn_RAW_SENS of this port to 40",
        "set MAV_n_MODE of this port to Onboard",
    )
    if message is None or not rate_hz:
        return Finding(Grade.NOTE, "no IMU: altitude and climb react more slowly", loop)
    if rate_hz < 20.0:
        refused = ", ".join(case.hearing.refused)
        why = f" (a higher rate was refused: {refused})" if refused else ""
        return Finding(
            Grade.NOTE,
            f"the IMU comes at {rate_hz:.0f} Hz{why}; from 25 Hz on it is used fully",
            loop,
        )
    return Finding(Grade.GOOD, f"IMU {message.get_type()} at {rate_hz:.0f} Hz")


def refusals(case: Case) -> Finding | None:
    refused = case.hearing.refused
    if not refused or case.vehicle is None:
        return None
    listed = ", ".join(f"{count} {name}" for name, count in refused.items())
    return Finding(
        Grade.NOTE,
        f"the vehicle refused requests for message rates ({listed})",
        case.either(
            "the firmware is old or the rate is above half its loop rate: set the SRn_ parameters of "
            "this port instead (RAW_SENS, EXT_STAT, EXTRA1, EXTRA3)",
            "set MAV_n_MODE of this port to Onboard",
        ),
    )


def version(case: Case) -> Finding | None:
    if case.vehicle is None or case.hearing.senders[case.vehicle].version == 2:
        return None
    return Finding(
        Grade.NOTE,
        "the vehicle speaks MAVLink 1: accuracies and ids above 255 are missing",
        case.either("set SERIALn_PROTOCOL = 2 for this port", "set MAV_PROTO_VER = 2"),
    )


def vehicle_clock(case: Case) -> Finding | None:
    if case.vehicle is None:
        return None
    streams = case.hearing.senders[case.vehicle].streams.values()
    if any(later < earlier for stream in streams for earlier, later in _pairs(stream.boot_ms)):
        return Finding(
            Grade.WRONG,
            "the vehicle's clock goes back: it restarts, or two vehicles have the same ids",
            "check the power supply; give each vehicle its own SYSID_THISMAV (ArduPilot) or "
            "MAV_SYS_ID (PX4)",
        )
    message = case.last(SYSTEM_TIME)
    if message is None:
        return None
    if not message.time_unix_usec:
        return Finding(Grade.NOTE, "the vehicle does not know the date yet (it comes with GNSS)")
    ahead_us = case.host_us - message.time_unix_usec
    if abs(ahead_us) > HOUR_US:
        return Finding(
            Grade.NOTE,
            f"this computer's date differs from the vehicle's by {ahead_us / HOUR_US:+.1f} h: dates of "
            "recordings are wrong, estimates are not",
            "let this computer take its time from the network or a clock module (timedatectl)",
        )
    return Finding(Grade.GOOD, "the clocks of vehicle and computer agree")


def loss(case: Case) -> Finding | None:
    if case.vehicle is None:
        return None
    sender = case.hearing.senders[case.vehicle]
    share = sender.lost / max(1, sender.lost + sender.frames)
    damaged = case.hearing.decoder.counters[FrameReject.CRC]
    if share < 0.02:
        return None
    return Finding(
        Grade.NOTE,
        f"{100 * share:.0f} % of the vehicle's frames are lost ({damaged} damaged)",
        "lower the rates (SRn_ parameters, streams.* of the configuration) or raise the baud rate; "
        "keep serial cables short, and connect ground",
    )


def own_ids(case: Case) -> Finding | None:
    own = (case.vehicle or (0, 0))[0], case.service.pipeline.identity.component_id
    if case.vehicle is None or own not in case.hearing.senders:
        return None
    return Finding(
        Grade.NOTE,
        f"another program uses {own[0]}/{own[1]}, our own ids",
        "stop it, or set identity.component_id (192 to 194)",
    )


def own_altitude(case: Case) -> Finding | None:
    if case.vehicle is None or not case.rate_hz(ALTITUDE):
        return None
    return Finding(
        Grade.NOTE,
        "the vehicle sends ALTITUDE itself, so Kollsman does not (publish.altitude: auto)",
        "to show Kollsman's, set publish.altitude: always",
    )


def health(case: Case) -> Finding | None:
    if case.service.pipeline.identity.vehicle is None:
        return None
    monitor = case.service.pipeline.health
    altitude_m = float(case.service.pipeline.estimate[0]["altitude_amsl_m"])
    if monitor.health.name == "OK":
        return Finding(Grade.GOOD, f"altitude {altitude_m:.1f} m: {monitor.reason}")
    return Finding(Grade.NOTE, f"health {monitor.health.name}: {monitor.reason}")


RULES: tuple[Callable[[Case], Finding | None], ...] = (
    nothing_received,
    no_mavlink,
    no_autopilot,
    not_followed,
    several_autopilots,
    barometer,
    gnss,
    inertial,
    refusals,
    version,
    vehicle_clock,
    loss,
    own_ids,
    own_altitude,
    health,
)


def report(case: Case, findings: list[Finding]) -> Iterator[str]:
    """The lines of the report."""
    hearing = case.hearing
    junk = {str(cause): count for cause, count in hearing.decoder.counters.items() if count}
    yield (
        f"{hearing.url}: {hearing.statistics.received_bytes} bytes in {hearing.duration_s():.0f} s, "
        f"{hearing.decoder.frames} MAVLink frames, bad input: {junk or 'none'}"
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


def _pairs(values: list[int]) -> Iterator[tuple[int, int]]:
    return pairwise(values)

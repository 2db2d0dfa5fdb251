"""Rules about the link, its senders, and clocks."""

from collections.abc import Iterator
from itertools import pairwise

from companion.doctor.case import Case, Finding, Grade, autopilots
from companion.mavlink.codec import FrameReject, mavlink
from companion.notices import signing_problem

SYSTEM_TIME = mavlink.MAVLINK_MSG_ID_SYSTEM_TIME
ALTITUDE = mavlink.MAVLINK_MSG_ID_ALTITUDE
LATE_S = 0.5
HOUR_US = 3_600_000_000


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


def signatures(case: Case) -> Finding | None:
    problem = signing_problem(case.service.pipeline)
    if problem is None:
        return None
    grade = Grade.NOTE if case.service.pipeline.signing is None else Grade.WRONG
    return Finding(grade, *problem)


def not_followed(case: Case) -> Finding | None:
    if case.vehicle is None or case.service.pipeline.identity.vehicle is not None:
        return None
    if signing_problem(case.service.pipeline) is not None:
        return None
    pilots = autopilots(case.hearing)
    named = " and ".join(f"{system}/{component}" for system, component in pilots)
    if len(pilots) > 1:
        cure = f"choose one with vehicle.system_id, for example {pilots[0][0]}"
    elif pilots[0][0] == 0:
        cure = "give the vehicle a system id: ArduPilot SYSID_THISMAV = 1, PX4 MAV_SYS_ID = 1"
    else:
        cure = "check vehicle.system_id of the configuration"
    return Finding(Grade.WRONG, f"autopilot {named} is heard but not followed", cure)


def several_autopilots(case: Case) -> Finding | None:
    pilots = autopilots(case.hearing)
    if len(pilots) < 2 or case.service.pipeline.identity.vehicle is None:
        return None
    named = " and ".join(f"{system}/{component}" for system, component in pilots)
    return Finding(
        Grade.NOTE,
        f"several autopilots are heard: {named}",
        "name the one to follow with vehicle.system_id; give each its own SYSID_THISMAV "
        "(ArduPilot) or MAV_SYS_ID (PX4)",
    )


def refusals(case: Case) -> Finding | None:
    refused = case.hearing.refused
    if not refused or case.vehicle is None:
        return None
    listed = ", ".join(f"{count} {name}" for name, count in refused.items())
    return Finding(
        Grade.NOTE,
        f"the vehicle refused requests for message rates ({listed})",
        case.either(
            "the firmware is old or the rate is above half its loop rate: set the SRn_ parameters "
            "of this port instead (RAW_SENS, EXT_STAT, EXTRA1, EXTRA3)",
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
            f"this computer's date differs from the vehicle's by {ahead_us / HOUR_US:+.1f} h: "
            "dates of recordings are wrong, estimates are not",
            "let this computer take its time from the network or a clock module (timedatectl)",
        )
    return Finding(Grade.GOOD, "the clocks of vehicle and computer agree")


def delay(case: Case) -> Finding | None:
    if case.vehicle is None:
        return None
    timesync, clock = case.service.timesync, case.service.pipeline.intake.clock
    age_s = timesync.age_s(case.host_us, clock.now_us)
    if not timesync.answered or not age_s > LATE_S:
        return None
    return Finding(
        Grade.NOTE,
        f"telemetry is {age_s:.1f} s old on arrival (round trip {timesync.round_trip_s:.1f} s)",
        "the link is full or buffers: lower the rates (streams.*), raise the baud rate, or take "
        "another radio; ALTITUDE is late by as much",
    )


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


def _pairs(values: list[int]) -> Iterator[tuple[int, int]]:
    return pairwise(values)

"""Rules about barometer, GNSS and IMU."""

import math

from companion.doctor.case import Case, Finding, Grade, rates_advice
from companion.mavlink.codec import mavlink

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


def barometer(case: Case) -> Finding | None:
    message = case.last(*PRESSURE_IDS)
    rate_hz = case.rate_hz(*PRESSURE_IDS)
    if case.vehicle is None:
        return None
    if message is None or not rate_hz:
        return Finding(
            Grade.WRONG, "no barometer (SCALED_PRESSURE)", rates_advice(case, "RAW_SENS")
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
            rates_advice(case, "RAW_SENS"),
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
            rates_advice(case, "EXT_STAT")
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
            f"GNSS height {message.alt * 1e-3:.1f} m AMSL without a reported accuracy; 10 m is "
            "assumed",
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
        "SCHED_LOOP_RATE bounds what is granted (Plane: 50 Hz, at most every second loop): 40 Hz "
        "or less is granted; or set SRn_RAW_SENS of this port to 40",
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

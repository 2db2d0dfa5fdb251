"""What the live page shows of a running service, or of a log: a snapshot in the report schema.

`Snapshots.poll` runs in the estimator's thread between two turns of its loop. Four times a second
it copies numbers that the pipeline keeps anyway; a sample costs nothing more with it than without.
"""

import logging
import math
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from companion.clock import Clock
from companion.health import Health
from companion.kernels.gnss import gnss_sd_m
from companion.links.base import LinkState
from companion.links.traffic import Traffic
from companion.mavlink.codec import mavlink
from companion.mavlink.identity import autopilot_name
from companion.pipeline import Pipeline
from companion.replay.findings import utc
from companion.replay.schema import ALTITUDE_KEYS, SESSION_KEYS, document
from companion.samples import FaultySensor, Kind, Verdict
from companion.settings import CompanionSettings
from companion.status import Text
from companion.web.board import Board, Snapshot

logger = logging.getLogger("kollsman.web")

PERIOD_US = 250_000
RATE_US = 2_000_000
"""Rates and verdicts are those of so long a time."""
FRESH_US = 2_000_000
SENSORS = tuple(kind for kind in Kind if kind not in (Kind.STATUS, Kind.HOME))
NEEDED = frozenset({Kind.PRESSURE, Kind.GNSS, Kind.IMU})
"""Kinds that are shown though none was heard, where the estimator uses them."""
MOST_EXCLUSIONS = 50
DRIFTS = ("calm", "fair", "stormy")
SEVERITIES = {
    number: entry.name.removeprefix("MAV_SEVERITY_").lower()
    for number, entry in mavlink.enums["MAV_SEVERITY"].items()
}

Counts = tuple[tuple[int, ...], ...]


class Peer(Protocol):
    """A link, or the log in place of one."""

    @property
    def url(self) -> str: ...

    @property
    def state(self) -> LinkState: ...


class Shown(Protocol):
    """What is shown: a running service, or the player of a log."""

    @property
    def link(self) -> Peer: ...

    @property
    def clock(self) -> Clock: ...

    settings: CompanionSettings
    pipeline: Pipeline
    published: int
    sent_frames: int
    outdated: int

    @property
    def texts(self) -> Sequence[Text]: ...

    @property
    def problems(self) -> list[str]: ...

    @property
    def heard_frames(self) -> int: ...

    def traffic(self) -> Mapping[str, Traffic]: ...

    def rejected(self) -> dict[str, int]: ...


class Snapshots:
    """Puts what a service is at the moment on a board.

    A snapshot that fails is logged once, and no further one is made: the altitude goes on.

    Parameters
    ----------
    command, number : `run` or `replay`, and the number of the session, for the report schema.
    """

    def __init__(self, service: Shown, board: Board, command: str = "run", number: int = 1) -> None:
        self._service = service
        self._board = board
        self._command, self._number = command, number
        self._start_us = self._due_us = service.clock.now_us()
        self._counts: deque[tuple[int, Counts]] = deque(maxlen=RATE_US // PERIOD_US + 1)
        self._changed_us: dict[Kind, int] = {}
        self._stamps: dict[str, tuple[int, int]] = {}
        """of the estimate and the heights: the newest stamp, and when it was first seen"""
        self._shares: Counter[Health] = Counter()
        self._first_boot_us: int | None = None
        self._heights_m: tuple[float, float, float] | None = None
        """first, lowest and highest altitude"""
        self._exclusions: deque[dict[str, Any]] = deque(maxlen=MOST_EXCLUSIONS)
        self._faulty = FaultySensor.NONE
        self._has_failed = False

    def poll(self) -> None:
        """Put a snapshot where one is due."""
        now_us = self._service.clock.now_us()
        if now_us < self._due_us or self._has_failed:
            return
        self._due_us = now_us + PERIOD_US
        try:
            self._board.put(self.take(now_us))
        except Exception:  # a page must never end the service
            self._has_failed = True
            logger.exception("the live page is not kept up to date any more")

    def take(self, now_us: int) -> Snapshot:
        """The state at `now_us` of the service's clock."""
        service = self._service
        self._follow(now_us)
        session = {**self._session(now_us), **self._live(now_us)}
        now, altitude = session["now"], session["altitude"]
        found = document(self._command, service.link.url, [session], time_s=now_us * 1e-6)
        names = ("altitude_m", "altitude_sd_m", "level_m", "climb_mps")
        heights = ("gnss_m", "baro_m", "autopilot_m")
        is_new = self._is_new("estimate", int(service.pipeline.estimate[0]["time_us"]), now_us)
        values = [now[name] for name in names] + [altitude["qnh_hpa"], altitude["qnh_sd_hpa"]]
        values = values if is_new else [None] * len(values)
        values[len(names) : len(names)] = [now[name] for name in heights]
        health = int(service.pipeline.health.health)
        row = (now_us * 1e-6, *(_rounded(value) for value in values), health)
        return Snapshot(found, row)

    def _follow(self, now_us: int) -> None:
        """Keep what is told over a time."""
        pipeline = self._service.pipeline
        counts = tuple(tuple(verdicts) for verdicts in pipeline.verdicts)
        before = self._counts[-1][1] if self._counts else None
        for kind in SENSORS:
            if sum(counts[kind]) != (sum(before[kind]) if before else 0):
                self._changed_us[kind] = now_us
        self._counts.append((now_us, counts))
        self._shares[pipeline.health.health] += 1
        if self._first_boot_us is None and pipeline.now_us >= 0:
            self._first_boot_us = pipeline.now_us
        height_m = float(pipeline.estimate[0]["altitude_amsl_m"])
        if math.isfinite(height_m):
            first_m, low_m, high_m = self._heights_m or (height_m, height_m, height_m)
            self._heights_m = first_m, min(low_m, height_m), max(high_m, height_m)
        self._follow_exclusion()

    def _follow_exclusion(self) -> None:
        estimate = self._service.pipeline.estimate[0]
        at_s = max(0, int(estimate["time_us"])) * 1e-6
        faulty = FaultySensor(int(estimate["faulty"]))
        if faulty is not self._faulty:
            if faulty is not FaultySensor.NONE:
                since_s = max(0, int(estimate["faulty_since_us"])) * 1e-6
                self._exclusions.append(self._exclusion(faulty.name.lower(), since_s))
            self._faulty = faulty
        if faulty is not FaultySensor.NONE:
            latest = self._exclusions[-1]
            latest["duration_s"] = max(latest["duration_s"], at_s - latest["boot_s"])

    def _exclusion(self, sensor: str, since_s: float) -> dict[str, Any]:
        """One that begins: as in a report, and with the vehicle's clock."""
        offset_us = self._service.pipeline.intake.clock.unix_offset_us
        return {
            "sensor": sensor,
            "boot_s": since_s,
            "from_s": since_s - (self._first_boot_us or 0) * 1e-6,
            "from_utc": None if offset_us is None else utc(round(since_s * 1e6) + offset_us),
            "duration_s": 0.0,
            "off_m": None,
            "step_m": None,
        }

    def _session(self, now_us: int) -> dict[str, Any]:
        """The keys that a replayed session has; those that need all of the flight are None."""
        return dict.fromkeys(SESSION_KEYS) | self._known(now_us)

    def _known(self, now_us: int) -> dict[str, Any]:
        service, pipeline = self._service, self._service.pipeline
        identity, value = pipeline.identity, pipeline.estimate[0]
        total = self._shares.total()
        offset_us, first_us = pipeline.intake.clock.unix_offset_us, self._first_boot_us
        first_m, low_m, high_m = self._heights_m or (None, None, None)
        return {
            "session": self._number,
            "start_utc": utc(self._start_us),
            "start_vehicle_utc": (
                None if offset_us is None or first_us is None else utc(first_us + offset_us)
            ),
            "start_boot_s": None if first_us is None else first_us * 1e-6,
            "vehicle": "/".join(map(str, identity.vehicle)) if identity.vehicle else None,
            "autopilot": autopilot_name(identity.autopilot) if identity.vehicle else None,
            "duration_s": (now_us - self._start_us) * 1e-6,
            "after_reboot": pipeline.intake.clock.reboots > 0,
            "estimator": service.settings.estimator,
            "health": {
                "at_end": pipeline.health.health.name,
                "reason": pipeline.health.reason,
                "share": {state.name: self._shares[state] / total for state in Health},
            },
            "notes": list(identity.notes),
            "samples": {
                kind.name.lower(): _named(pipeline.verdicts[kind])
                for kind in Kind
                if sum(pipeline.verdicts[kind])
            },
            "left_out": {str(cause): n for cause, n in pipeline.intake.counters.items() if n},
            "altitude": dict.fromkeys(ALTITUDE_KEYS)
            | {
                "first_m": first_m,
                "min_m": low_m,
                "max_m": high_m,
                "last_m": float(value["altitude_amsl_m"]),
                "above_takeoff_last_m": float(value["height_above_takeoff_m"]),
                "qnh_hpa": float(value["qnh_pa"]) * 0.01,
                "qnh_sd_hpa": float(value["qnh_sd_pa"]) * 0.01,
                "baro_offset_m": float(value["baro_offset_m"]),
                "published": service.published,
            },
            "exclusions": [dict(each) for each in self._exclusions],
        }

    def _live(self, now_us: int) -> dict[str, Any]:
        """The keys that only a running service has."""
        service = self._service
        return {
            "now": self._now(now_us),
            "problems": service.problems,
            "sensors": self._sensors(now_us),
            "feedback": self._feedback(),
            "texts": [
                {"time_s": us * 1e-6, "from": who, "severity": SEVERITIES.get(level), "text": text}
                for us, who, level, text in service.texts
            ],
            "link": {
                "state": service.link.state.name.lower(),
                "frames": service.heard_frames,
                "sent": service.sent_frames,
                "outdated": service.outdated,
                "traffic": {url: each.as_dict() for url, each in service.traffic().items()},
                "rejected": service.rejected(),
                "radio": self._radio(now_us),
            },
        }

    def _radio(self, now_us: int) -> dict[str, Any] | None:
        """The newest report of a telemetry radio on any link."""
        heard = [each.radio for each in self._service.traffic().values() if each.radio is not None]
        if not heard:
            return None
        radio, at_us = max(heard, key=lambda each: each[1])
        return radio.as_dict() | {"age_s": (now_us - at_us) * 1e-6}

    def _is_new(self, name: str, stamp_us: int, now_us: int) -> bool:
        """Whether a stamp of the vehicle's clock has moved in the last two seconds of ours."""
        stamp, since_us = self._stamps.get(name, (None, now_us))
        if stamp != stamp_us:
            self._stamps[name] = (stamp_us, now_us)
            return True
        return now_us - since_us <= FRESH_US

    def _height(self, name: str, height: tuple[int, float], now_us: int) -> float:
        """A height with its stamp on the vehicle's clock; NaN when it is old."""
        is_old = abs(self._service.pipeline.now_us - height[0]) > FRESH_US
        return height[1] if self._is_new(name, height[0], now_us) and not is_old else math.nan

    def _now(self, now_us: int) -> dict[str, Any]:
        """The estimate and the heights beside it."""
        pipeline = self._service.pipeline
        value, boot_us, sensors = pipeline.estimate[0], pipeline.now_us, pipeline.checker.sensors
        own = pipeline.outputs.own
        own_m = own_height_m = math.nan
        if own is not None:
            own_m = self._height("autopilot", (own.time_us, own.altitude_amsl_m), now_us)
            own_height_m = own.height_above_home_m if math.isfinite(own_m) else math.nan
        height_m = float(value["height_above_takeoff_m"])
        return {
            "boot_s": boot_us * 1e-6 if boot_us >= 0 else None,
            "altitude_m": float(value["altitude_amsl_m"]),
            "altitude_sd_m": float(value["altitude_sd_m"]),
            "level_m": float(value["protection_level_m"]),
            "climb_mps": float(value["climb_mps"]),
            "climb_sd_mps": float(value["climb_sd_mps"]),
            "above_takeoff_m": height_m if math.isfinite(height_m) else own_height_m,
            "baro_rate_mps": float(value["baro_rate_mps"]),
            "gnss_offset_m": float(value["gnss_offset_m"]),
            "gnss_m": self._height("gnss", sensors.gnss, now_us),
            "baro_m": self._height("baro", sensors.baro, now_us),
            "autopilot_m": own_m,
            "drift_probabilities": dict(
                zip(DRIFTS, map(float, value["drift_probabilities"]), strict=True)
            ),
            "excluded": self._faulty.name.lower() if self._faulty else None,
            "sends": pipeline.outputs.source.value,
        }

    def _sensors(self, now_us: int) -> dict[str, Any]:
        """Rate, age and verdicts of each kind that was heard or is needed."""
        pipeline = self._service.pipeline
        (first_us, first), (last_us, last) = self._counts[0], self._counts[-1]
        elapsed_s = max(1e-3, (last_us - first_us) * 1e-6)
        found: dict[str, Any] = {}
        for kind in SENSORS:
            total = sum(last[kind])
            if not total and kind not in NEEDED & pipeline.filter.method.uses:
                continue
            given = [now - then for now, then in zip(last[kind], first[kind], strict=True)]
            changed_us = self._changed_us.get(kind)
            found[kind.name.lower()] = {
                "rate_hz": sum(given) / elapsed_s if len(self._counts) > 1 else None,
                "age_s": (now_us - changed_us) * 1e-6 if changed_us is not None else None,
                "verdicts": _named(given),
                "used": kind in pipeline.filter.method.uses,
                **(self._detail(kind) if total else {}),
            }
        return found

    def _detail(self, kind: Kind) -> dict[str, Any]:
        """What the newest sample of a kind says, besides its time."""
        row = self._service.pipeline.intake.newest(kind)
        if kind is Kind.GNSS:
            return {
                "fix_type": int(row[0]["fix_type"]),
                "satellites": int(row[0]["satellites"]),
                "sd_m": float(gnss_sd_m(row, 0.0, math.nan)),
            }
        if kind is Kind.PRESSURE:
            return {"pressure_hpa": float(row[0]["pressure_pa"]) * 0.01}
        if kind is Kind.RANGE:
            return {"distance_m": float(row[0]["distance_m"])}
        return {}

    def _feedback(self) -> dict[str, Any]:
        feedback = self._service.pipeline.feedback
        return {
            "mode": feedback.settings.mode,
            "phase": feedback.phase.name.lower(),
            "hold": feedback.hold.value,
            "why_ended": feedback.why_ended,
            "offset_m": feedback.offset_m,
            "writes": feedback.writes,
        }


def _named(counts: "list[int] | tuple[int, ...]") -> dict[str, int]:
    return {verdict.name.lower(): counts[verdict] for verdict in Verdict if counts[verdict]}


def _rounded(value: float | None) -> float | None:
    return round(value, 3) if value is not None and math.isfinite(value) else None

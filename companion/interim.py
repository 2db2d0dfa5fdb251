"""The autopilot's own height in ALTITUDE while the estimators are loaded.

Loading takes two seconds on a PC and ten on a Raspberry Pi; compiling, after an installation, takes
minutes. A ground station that heard our ALTITUDE before a crash shows nothing else (see
`companion.mavlink.outputs`), so its display would be frozen for so long. Many peers speak only to
who spoke. So a thread begins with our HEARTBEAT and these heights, from modules that load at once,
until `Interim.stop` hands the link over to the service.
"""

import logging
import math
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import ConfigDict

from companion import locations
from companion.clock import Clock
from companion.config import Settings, load, validate
from companion.errors import ConfigError
from companion.key_file import SigningStore, open_signing
from companion.links import Link
from companion.mavlink.codec import Decoder, Encoder, Frame, Message, mavlink
from companion.mavlink.identity import Origin
from companion.mavlink.own_heights import own_altitude, own_heights
from companion.mavlink.schedule import Schedule
from companion.mavlink.sections import (
    IdentitySettings,
    PublishSettings,
    VehicleSettings,
    identity_of,
)
from companion.mavlink.signing import SigningSettings

logger = logging.getLogger("kollsman.service")

POLL_S = 0.1
SWITCH_S = 0.0005
DRAIN_S = 1.0
HEARTBEAT_US = 1_000_000
PATIENCE_US = 1_500_000
"""how long an autopilot that may send ALTITUDE itself is listened to first"""
VEHICLE_ALTITUDE_US = 5_000_000
TEXT = b"Kollsman starts: the autopilot's own height"


class EarlyAir(Settings):
    """The key of section ``air`` that says who is not the vehicle."""

    model_config = ConfigDict(extra="ignore")

    reference_system_id: int | None = None


class EarlySettings(Settings):
    """The sections that are read before the estimators are loaded; the others are read later."""

    model_config = ConfigDict(extra="ignore")

    vehicle: VehicleSettings = VehicleSettings()
    identity: IdentitySettings = IdentitySettings()
    publish: PublishSettings = PublishSettings()
    air: EarlyAir = EarlyAir()
    signing: SigningSettings = SigningSettings()


class _Values(Settings):
    """Any configuration file."""

    model_config = ConfigDict(extra="allow")


def early_settings(config: Path | None, changes: Sequence[str]) -> EarlySettings:
    """What the configuration says of these sections, as `common_cli.resolve_settings` reads it.

    Raises `ConfigError`; what is wrong in other sections is found later.
    """
    path = config or locations.config_path()
    values: dict[str, Any] = load(path, _Values).model_dump() if path is not None else {}
    for text in (*locations.assignments(), *changes):
        key, _, value = text.partition("=")
        section, _, name = key.strip().partition(".")
        if section in EarlySettings.model_fields and name:
            held = values[section] = dict(values.get(section) or {})
            try:
                held[name] = yaml.safe_load(value)
            except (yaml.YAMLError, ValueError):
                raise ConfigError(f"--set {text}: the value is no number and no text") from None
    return validate(values, EarlySettings, source=str(path or "options"))


def begin(
    link: Link, clock: Clock, config: Path | None, changes: Sequence[str]
) -> "Interim | None":
    """An `Interim` that runs; None where the configuration cannot be used, which is reported when
    all of it is read. Raises `ConfigError` for a signing key that cannot be used."""
    try:
        settings = early_settings(config, changes)
    except ConfigError:
        return None
    made = Interim(link, settings, clock)
    made.start()
    return made


class Interim:
    """Serves `link` from a thread until `stop`.

    Parameters
    ----------
    link : open; nobody else may use it meanwhile.
    """

    def __init__(self, link: Link, settings: EarlySettings, clock: Clock) -> None:
        other_id = settings.air.reference_system_id
        self.identity = identity_of(settings.vehicle, settings.identity, other_id)
        self.signing: SigningStore | None = open_signing(settings.signing)
        self._link, self._settings, self._clock = link, settings.publish, clock
        self._decoder = Decoder()
        self._encoders: dict[tuple[int, int], Encoder] = {}
        self._slots = Schedule(settings.publish.altitude_hz)
        self._heartbeat_us = self._followed_us = -HEARTBEAT_US
        self._vehicle_altitude_us = -VEHICLE_ALTITUDE_US
        self._origin_m = math.nan
        self._usual_s = sys.getswitchinterval()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._work, name="interim", daemon=True)

    def start(self) -> None:
        """Begin. Python's threads take turns more often meanwhile: loading must not hold back what
        arrives."""
        self._usual_s = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH_S)
        self._thread.start()

    def stop(self) -> None:
        """End the thread; the link is free then, and holds nothing old."""
        if self._done.is_set():
            return
        self._done.set()
        self._thread.join()
        sys.setswitchinterval(self._usual_s)
        end_s = time.monotonic() + DRAIN_S
        while self._link.receive(0.0) and time.monotonic() < end_s:
            pass

    def turn(self, timeout_s: float) -> None:
        """Wait for bytes at most `timeout_s`, and do what is due."""
        data = self._link.receive(timeout_s)
        now_us = self._clock.now_us()
        frames = self._decoder.feed(data) if data else []
        if frames:
            self._link.trust()
        for frame in frames:
            self._take(frame, now_us)
        if now_us - self._heartbeat_us >= HEARTBEAT_US:
            self._heartbeat_us = now_us
            self._send(_heartbeat())
            if self.signing is not None:
                self.signing.keep()

    def _work(self) -> None:
        try:
            while not self._done.is_set():
                self.turn(POLL_S)
        except Exception:  # the service comes next, and does the same
            logger.exception("the autopilot's own height is not sent on while the estimators load")

    def _take(self, frame: Frame, now_us: int) -> None:
        if self.signing is not None and self.signing.signing.refusal(frame) is not None:
            return
        speaker, source = (frame.system_id, frame.component_id), self._link.source
        is_heartbeat = frame.message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT
        if is_heartbeat and speaker not in (self.identity.vehicle, self.identity.own):
            message = self._decoder.decode(frame)
            if message is not None and self.identity.heartbeat(frame, message, now_us, source):
                self._followed_us = now_us
        if self.identity.origin(frame, now_us, source) is not Origin.VEHICLE:
            return
        if frame.message_id == mavlink.MAVLINK_MSG_ID_ALTITUDE:
            self._vehicle_altitude_us = now_us
        elif frame.message_id == mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
            message = self._decoder.decode(frame)
            if message is not None and self._may_send(now_us):
                self._own_height(message)

    def _may_send(self, now_us: int) -> bool:
        wish: Literal["auto", "always", "never"] = self._settings.altitude
        if wish != "auto":
            return wish == "always"
        is_ardupilot = self.identity.autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
        patience_us = 0 if is_ardupilot else PATIENCE_US
        return (
            now_us - self._followed_us >= patience_us
            and now_us - self._vehicle_altitude_us >= VEHICLE_ALTITUDE_US
        )

    def _own_height(self, message: Message) -> None:
        own = own_heights(message)
        if not self._slots.takes(own.time_us):
            return
        if math.isnan(self._origin_m):
            self._origin_m = own.altitude_amsl_m
            if self._settings.statustext:
                self._send(mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_NOTICE, TEXT))
        self._send(own_altitude(own, self._origin_m))

    def _send(self, message: Message) -> None:
        own = self.identity.own
        if own not in self._encoders:
            signing = self.signing.signing if self.signing is not None else None
            self._encoders[own] = Encoder(*own, signing)
        frame = self._encoders[own].encode(message, self.identity.spoken)
        if frame:
            self._link.send(frame)


def _heartbeat() -> Message:
    """Ours, while the estimators are loaded."""
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
        mavlink.MAV_AUTOPILOT_INVALID,
        0,
        0,
        mavlink.MAV_STATE_BOOT,
        3,
    )

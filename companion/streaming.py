"""The message rates of the vehicle on a live link: who requests them, and when all of them anew."""

from companion.estimators import ESTIMATORS
from companion.mavlink.codec import Message, mavlink
from companion.mavlink.identity import Origin
from companion.mavlink.streams import planned, wanted
from companion.mavlink.supervisor import StreamSupervisor, logger
from companion.pipeline import Pipeline
from companion.settings import CompanionSettings

PLANES = frozenset(
    {
        mavlink.MAV_TYPE_FIXED_WING,
        mavlink.MAV_TYPE_VTOL_DUOROTOR,
        mavlink.MAV_TYPE_VTOL_QUADROTOR,
        mavlink.MAV_TYPE_VTOL_TILTROTOR,
        mavlink.MAV_TYPE_VTOL_RESERVED2,
        mavlink.MAV_TYPE_VTOL_RESERVED3,
        mavlink.MAV_TYPE_VTOL_RESERVED4,
        mavlink.MAV_TYPE_VTOL_RESERVED5,
    }
)
"""ArduPlane's types: it saves the rates of REQUEST_DATA_STREAM to its parameters"""


class Streaming:
    """Supervises the streams of the pipeline's vehicle once there is one.

    Parameters
    ----------
    link_bytes_per_s : what the link carries; None where that is unknown or plenty.
    """

    def __init__(
        self, pipeline: Pipeline, settings: CompanionSettings, link_bytes_per_s: float | None
    ) -> None:
        self._pipeline = pipeline
        self._settings = settings
        self._link_bytes_per_s = settings.streams.link_bytes_per_s or link_bytes_per_s
        self._supervisor: StreamSupervisor | None = None
        self._vehicle: tuple[int, int] | None = None
        self._path: tuple[object, ...] = ()

    @property
    def problems(self) -> list[str]:
        """What is slow, missing or refused now."""
        return self._supervisor.problems if self._supervisor is not None else []

    def poll(self, now_us: int, path: tuple[object, ...]) -> list[Message]:
        """The requests to send now.

        `path` : whatever changes when the link was reconnected or the vehicle speaks from
        elsewhere.
        """
        pipeline = self._pipeline
        identity = pipeline.identity
        if not self._settings.streams.request or identity.vehicle is None:
            return []
        path = (*path, pipeline.intake.clock.reboots)
        if self._supervisor is None or identity.vehicle != self._vehicle:
            self._supervisor, self._vehicle, self._path = self._begin(), identity.vehicle, path
        elif path != self._path:
            self._path = path
            self._supervisor.restart("the vehicle or the link was restarted")
        stations = ", ".join(f"{ids[0]}/{ids[1]}" for ids in sorted(identity.stations))
        frames = identity.counters[Origin.VEHICLE]
        return self._supervisor.poll(now_us, pipeline.now_us, pipeline.heard, frames, stations)

    def acknowledge(self, message: Message, now_us: int) -> None:
        """COMMAND_ACK from the vehicle."""
        if self._supervisor is not None:
            self._supervisor.acknowledge(message, now_us)

    def other_request(self, now_us: int, who: str) -> None:
        """Another program requested rates from the vehicle."""
        if self._supervisor is not None:
            self._supervisor.other_request(now_us, who)

    def restore(self) -> list[Message]:
        """What puts the rates back, for the end of a run."""
        return self._supervisor.restore() if self._supervisor is not None else []

    def _begin(self) -> StreamSupervisor:
        settings, identity = self._settings, self._pipeline.identity
        assert identity.vehicle is not None
        uses = ESTIMATORS[settings.estimator].uses
        is_px4 = identity.autopilot == mavlink.MAV_AUTOPILOT_PX4
        full = wanted(
            settings.streams,
            uses,
            identity.autopilot,
            vehicle_height=settings.publish.altitude != "never",
        )
        plan = planned(full, self._link_bytes_per_s)
        listed = ", ".join(f"{stream.name} {stream.rate_hz:g} Hz" for stream in plan)
        logger.info("requesting from the vehicle: %s", listed)
        lowered = [
            f"{now.name} {before.rate_hz:g} -> {now.rate_hz:g} Hz"
            for before, now in zip(full, plan, strict=True)
            if now != before
        ]
        if lowered:
            logger.warning(
                "the link carries %.0f bytes/s: lowered %s",
                self._link_bytes_per_s,
                ", ".join(lowered),
            )
        data_stream = settings.streams.data_stream
        saves = (
            identity.autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
            and identity.vehicle_type in PLANES
        )
        use_groups = data_stream == "always" or (data_stream == "auto" and not saves and not is_px4)
        return StreamSupervisor(plan, identity.vehicle, use_groups=use_groups)

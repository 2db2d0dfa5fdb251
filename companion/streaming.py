"""The message rates of the vehicle on a live link: who requests them, and when all of them anew;
and the request for a message that only a simulated vehicle has."""

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

REQUEST_MESSAGE: int = mavlink.MAV_CMD_REQUEST_MESSAGE
SIMULATOR_MESSAGES = {
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: mavlink.MAVLINK_MSG_ID_SIMSTATE,
    mavlink.MAV_AUTOPILOT_PX4: mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION,
}
"""What only a simulated vehicle sends, by autopilot. ArduPilot answers MAV_CMD_REQUEST_MESSAGE for
a message that it does not have with FAILED alone, but SET_MESSAGE_INTERVAL with a STATUSTEXT."""
SIMULATOR_PERIOD_US, SIMULATOR_ATTEMPTS = 2_000_000, 5


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
        self._simulator_us, self._simulator_attempts = 0, 0

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
            self._simulator_attempts = 0
        elif path != self._path:
            self._path = path
            self._supervisor.restart("the vehicle or the link was restarted")
        stations = ", ".join(f"{ids[0]}/{ids[1]}" for ids in sorted(identity.stations))
        frames = identity.counters[Origin.VEHICLE]
        requests = self._supervisor.poll(now_us, pipeline.now_us, pipeline.heard, frames, stations)
        return requests + self._ask_whether_simulated(now_us)

    def _ask_whether_simulated(self, now_us: int) -> list[Message]:
        """Ask for the simulator's message, while that decides what the GNSS heights mean."""
        identity = self._pipeline.identity
        message_id = SIMULATOR_MESSAGES.get(identity.autopilot)
        is_due = self._simulator_attempts < SIMULATOR_ATTEMPTS and now_us >= self._simulator_us
        if not (self._pipeline.intake.simulation.in_question and is_due and message_id):
            return []
        self._simulator_us = now_us + SIMULATOR_PERIOD_US
        self._simulator_attempts += 1
        assert identity.vehicle is not None
        values = (message_id, 0, 0, 0, 0, 0, 0)
        return [
            mavlink.MAVLink_command_long_message(*identity.vehicle, REQUEST_MESSAGE, 0, *values)
        ]

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

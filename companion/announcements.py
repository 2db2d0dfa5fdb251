"""What the pilot is told about us in STATUSTEXT: each change once."""

from companion.health import HealthMonitor, excluded
from companion.mavlink.codec import Message, mavlink
from companion.mavlink.outputs import SEVERITY, Source
from companion.mavlink.texts import StatusTexts
from companion.samples import Rows

OWN_HEIGHT_TEXT = "ALTITUDE: the autopilot's own height"
FAREWELL_TEXT = b"Kollsman stops: the autopilot's own height"


class Announcements:
    """Texts that wait to be sent, and what was told last.

    Parameters
    ----------
    enabled : False sends only the notice that another program uses our ids.
    """

    def __init__(self, *, enabled: bool) -> None:
        self._enabled = enabled
        self._texts = StatusTexts()
        self.told_source = Source.NONE
        """the source of the height in ALTITUDE, as it was told last"""
        self.told_excluded = 0
        """the excluded sensor, as it was told last"""
        self._problems: list[str] = []

    @property
    def waiting_us(self) -> list[int]:
        """As `StatusTexts.waiting_us`."""
        return self._texts.waiting_us

    def due(self, host_us: int) -> list[Message]:
        """The messages to send now."""
        return self._texts.due(host_us)

    def new_vehicle(self) -> None:
        """Another vehicle is followed: none of its sensors is excluded yet."""
        self.told_excluded = 0

    def health(self, monitor: HealthMonitor) -> None:
        """Health changed."""
        health = monitor.health
        self._say("health", health, SEVERITY[health], f" {health.name}: {monitor.reason}")

    def excluded(self, faulty: int, estimate: Rows) -> None:
        """Another sensor is excluded, or none any more: `faulty` of the estimate."""
        if faulty != self.told_excluded and self._enabled:
            self.told_excluded = faulty
            text = excluded(estimate) or "all sensors used again"
            self._say("excluded", faulty, mavlink.MAV_SEVERITY_WARNING, f": {text}")

    def source(self, source: Source) -> None:
        """ALTITUDE carries the vehicle's own height from now on, or ours; the text about health
        tells that it is ours again."""
        if source is self.told_source:
            return
        self.told_source = source
        if source is Source.VEHICLE and self._enabled:
            self._texts.say("source", source, mavlink.MAV_SEVERITY_NOTICE, OWN_HEIGHT_TEXT)
        else:
            self._texts.retract("source")

    def streams(self, problems: list[str]) -> None:
        """Streams that are slow, missing or refused now."""
        if problems == self._problems:
            return
        last, self._problems = self._problems, problems
        kinds = [problem.split(":")[0] for problem in problems]
        if kinds != [problem.split(":")[0] for problem in last]:
            severity = mavlink.MAV_SEVERITY_WARNING if problems else mavlink.MAV_SEVERITY_INFO
            text = "; ".join(problems) or "all streams arrive"
            self._say("streams", tuple(kinds), severity, f": {text}")

    def restart(self, reason: str, restarts: int) -> None:
        """The estimator was restarted for the `restarts`-th time."""
        self._say("restart", restarts, mavlink.MAV_SEVERITY_WARNING, f": {reason}")

    def ids(self, text: str) -> None:
        """Another program uses our ids."""
        self._texts.say("ids", text, mavlink.MAV_SEVERITY_WARNING, text)

    def farewell(self) -> list[Message]:
        """The last text of a run."""
        notice = mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_NOTICE, FAREWELL_TEXT)
        return [notice] if self._enabled else []

    def _say(self, kind: str, state: object, severity: int, text: str) -> None:
        if self._enabled:
            self._texts.say(kind, state, severity, f"Kollsman{text}")

"""The whole of companion.yaml: one model made of the sections' own. Every key is optional."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import Field, create_model, model_validator

from companion.checkpoint_settings import CheckpointSettings
from companion.config import Settings, load, validate
from companion.errors import ConfigError
from companion.estimators import DEFAULT_ESTIMATOR, ESTIMATORS
from companion.feedback import FeedbackSettings
from companion.health import HealthSettings
from companion.intake import IntakeSettings
from companion.known_air import AirSettings
from companion.mavlink.sections import IdentitySettings, PublishSettings, VehicleSettings
from companion.mavlink.signing import SigningSettings
from companion.mavlink.streams import StreamSettings
from companion.recording import RecordSettings
from companion.web.settings import HttpSettings

EstimatorSections: type[Settings] = create_model(
    "EstimatorSections",
    __base__=Settings,
    **{
        name.replace("-", "_"): (
            method.settings,
            Field(default_factory=method.settings, alias=name),
        )
        for name, method in ESTIMATORS.items()
    },  # type: ignore[call-overload]
)
"""One section an estimator, named after it."""


class CompanionSettings(Settings):
    """companion.yaml."""

    estimator: Literal[tuple(ESTIMATORS)] = DEFAULT_ESTIMATOR  # type: ignore[valid-type]
    """name of the estimator; `kollsman estimators` lists them"""
    vehicle: VehicleSettings = VehicleSettings()
    identity: IdentitySettings = IdentitySettings()
    intake: IntakeSettings = IntakeSettings()
    air: AirSettings = AirSettings()
    health: HealthSettings = HealthSettings()
    publish: PublishSettings = PublishSettings()
    streams: StreamSettings = StreamSettings()
    signing: SigningSettings = SigningSettings()
    feedback: FeedbackSettings = FeedbackSettings()
    record: RecordSettings = RecordSettings()
    checkpoint: CheckpointSettings = CheckpointSettings()
    http: HttpSettings = HttpSettings()
    estimators: EstimatorSections = EstimatorSections()

    @model_validator(mode="after")
    def _reference_is_another(self) -> "CompanionSettings":
        system_id = self.air.reference_system_id
        if system_id is not None and system_id == self.vehicle.system_id:
            raise ValueError("air.reference_system_id: is the vehicle's; give another system's")
        return self

    def section(self, estimator: str) -> Settings:
        """The section of an estimator."""
        section: Settings = getattr(self.estimators, estimator.replace("-", "_"))
        return section

    def given(self) -> dict[str, Any]:
        """The keys that were given, as a file would hold them: presets and defaults stay below."""
        return self.model_dump(by_alias=True, exclude_unset=True)

    def with_changes(self, **changes: Any) -> "CompanionSettings":
        """A copy with top-level values replaced, as options of the command line do. Raises
        `ConfigError`."""
        return validate(self.given() | changes, CompanionSettings, source="options")

    def with_assignments(self, assignments: Sequence[str]) -> "CompanionSettings":
        """A copy with values replaced by texts such as ``estimators.vertical-bank.offset_sd_m=4``;
        a list is [a, b, c].

        Raises `ConfigError`: one line for a text that is none, a key that is unknown, a value that
        is not allowed.
        """
        known, values = self.model_dump(by_alias=True), self.given()
        for text in assignments:
            key, equals, value = text.partition("=")
            *path, last = key.strip().split(".")
            exists: Any = known
            section: Any = values
            for part in path:
                exists = exists.get(part) if isinstance(exists, dict) else None
                section = section.setdefault(part, {}) if isinstance(exists, dict) else None
            if not equals or not isinstance(section, dict):
                hint = "no such section" if equals else "give SECTION.KEY=VALUE"
                raise ConfigError(f"--set {text}: {hint}")
            try:
                section[last] = yaml.safe_load(value)
            except (yaml.YAMLError, ValueError):
                raise ConfigError(
                    f"--set {text}: the value is neither a number, a text nor a list"
                ) from None
        return validate(values, CompanionSettings, source="--set")


def load_settings(path: Path | None = None, **changes: Any) -> CompanionSettings:
    """The configuration at `path`, or the defaults; `changes` that are not None replace top-level
    values."""
    settings = load(path, CompanionSettings) if path is not None else CompanionSettings()
    given = {key: value for key, value in changes.items() if value is not None}
    return settings.with_changes(**given) if given else settings

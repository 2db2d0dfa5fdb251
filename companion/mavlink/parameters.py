"""Our settings as MAVLink parameters, so that a ground station shows them and sets QNH in flight.

Every parameter is a key of companion.yaml, or of section ``air`` as it may change in flight; its
text, range and unit are those of the key's model. All are REAL32; unknown is NaN. A request to set
another parameter is answered with its present value, as the protocol demands.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from companion.config.fields import allowed_of, meaning_of, unit_of
from companion.mavlink.codec import Message, mavlink

LONGEST_NAME = 16
REAL32 = mavlink.MAV_PARAM_TYPE_REAL32
BY_NAME = -1
"""``param_index`` of a request that names the parameter"""

NAMES = {
    "AIR_QNH_HPA": "air.qnh_hpa",
    "AIR_TEMP_C": "air.temperature_c",
    "AIR_FIELD_M": "air.field_elevation_m",
    "GNSS_LATENCY_S": "intake.gnss_latency_s",
    "HLTH_SD_LOST_M": "health.sd_lost_m",
    "HLTH_SD_OK_M": "health.sd_ok_m",
    "PUB_ALT_HZ": "publish.altitude_hz",
    "PUB_DEBUG_HZ": "publish.debug_hz",
}
"""name on the link -> key; those of section ``air`` can be set"""
SETTABLE = "air."


@dataclass(frozen=True)
class Parameter:
    """One parameter."""

    name: str
    key: str
    text: str
    allowed: str
    unit: str

    @property
    def is_settable(self) -> bool:
        return self.key.startswith(SETTABLE)


class Parameters:
    """Answers PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET.

    Parameters
    ----------
    settings : the configuration, whose values are shown.
    model : of the keys of the air, which can be set in flight.
    air : gives what holds their values as attributes, None where unknown; its ``set`` takes keys
        and raises ValueError for a value that is not possible.
    """

    def __init__(self, settings: BaseModel, model: type[BaseModel], air: Callable[[], Any]) -> None:
        self._settings, self._air = settings, air
        self.table = tuple(
            _described(name, key, model if key.startswith(SETTABLE) else type(settings))
            for name, key in sorted(NAMES.items())
        )
        self._index = {parameter.name: index for index, parameter in enumerate(self.table)}

    def answer(self, message: Message) -> list[Message]:
        """The PARAM_VALUEs that answer a request addressed to us; none to an unknown name."""
        match message.get_type():
            case "PARAM_REQUEST_LIST":
                return [self._value(index) for index in range(len(self.table))]
            case "PARAM_REQUEST_READ":
                index = message.param_index
                if index == BY_NAME:
                    index = self._index.get(message.param_id, BY_NAME)
                return [self._value(index)] if 0 <= index < len(self.table) else []
            case "PARAM_SET":
                index = self._index.get(message.param_id, BY_NAME)
                if index == BY_NAME:
                    return []
                self._set(self.table[index], message.param_value)
                return [self._value(index)]
        return []

    def value(self, name: str) -> float:
        """The present value of a parameter; NaN where unknown."""
        section, key = self.table[self._index[name]].key.split(".")
        in_air = f"{section}." == SETTABLE
        value = getattr(self._air() if in_air else getattr(self._settings, section), key)
        return math.nan if value is None else float(value)

    def _set(self, parameter: Parameter, value: float) -> None:
        if not parameter.is_settable or not math.isfinite(value):
            return
        try:
            self._air().set(**{parameter.key.removeprefix(SETTABLE): value})
        except ValueError:
            return  # out of range: the answer carries the value that stays

    def _value(self, index: int) -> Message:
        name = self.table[index].name
        return mavlink.MAVLink_param_value_message(
            name.encode("ascii"), self.value(name), REAL32, len(self.table), index
        )


def _described(name: str, key: str, model: type[BaseModel]) -> Parameter:
    owner: Any = model
    *sections, last = (
        key.removeprefix(SETTABLE).split(".") if key.startswith(SETTABLE) else key.split(".")
    )
    for section in sections:
        owner = owner.model_fields[section].annotation
    field = owner.model_fields[last]
    return Parameter(name, key, meaning_of(field), allowed_of(field), unit_of(last))

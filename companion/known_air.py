"""Values of the air that the user gives: QNH, air temperature, field elevation.

They come from section ``air`` of the configuration, or live through `KnownAir.set`; a reference
barometer (`companion.reference`) tells a QNH that is measured now. The pipeline
gives them to the estimator as an AIR sample before the next pressure; the elevation of the field,
while the vehicle rests on it (`companion.at_rest`), again every two seconds.
"""

import logging
import math
import re
from typing import NamedTuple

import numpy as np
from pydantic import Field, field_validator, model_validator

from companion.at_rest import NEVER_US, AtRest, contradiction_m, rests
from companion.config import Settings, validate
from companion.jit import step
from companion.reference import ReferenceBarometer
from companion.samples import Kind, Rows, rows

logger = logging.getLogger("kollsman.air")

HPA_PER_INHG = 33.86389
AGAIN_US = 2_000_000
"""The elevation is told again after this long at rest: fixes have moved the estimate since."""
KNOWN = np.dtype(
    [
        ("untold", "i8"),  # 1 while the estimator does not know QNH and temperature
        ("elevation_m", "f8"),  # of the field; NaN unknown
        ("told_us", "i8"),  # when the elevation was told last; NEVER_US before the first
        ("warned", "i8"),  # 1 while GNSS contradicts it, after a warning
    ],
    align=True,
)
_QNH = re.compile(r"\bQ(\d{4})\b")
_ALTIMETER = re.compile(r"\bA(\d{4})\b")
_TEMPERATURE = re.compile(r"\b(M?\d{2})/(?:M?\d{2}|//)?(?=\s|$)")
_TRENDS = re.compile(r"\b(RMK|TEMPO|BECMG|NOSIG)\b")


class Report(NamedTuple):
    """Pressure and temperature of a METAR; None where it tells none."""

    qnh_hpa: float | None
    temperature_c: float | None


def read_metar(text: str) -> Report:
    """QNH (Q1013 or A2992) and temperature (12/08) of a METAR; remarks and trends are left out."""
    body = _TRENDS.split(text.upper())[0]
    qnh, altimeter, air = _QNH.search(body), _ALTIMETER.search(body), _TEMPERATURE.search(body)
    qnh_hpa = float(qnh[1]) if qnh else None
    if qnh_hpa is None and altimeter:
        qnh_hpa = float(altimeter[1]) * 0.01 * HPA_PER_INHG
    temperature_c = float(air[1].replace("M", "-")) if air else None
    return Report(qnh_hpa, temperature_c)


class AirSettings(Settings):
    """Section ``air``: values of the air that the user gives."""

    qnh_hpa: float | None = Field(None, ge=850, le=1100)
    """altimeter setting (QNH) of the field of the take-off; default: as GNSS shows."""
    temperature_c: float | None = Field(None, ge=-90, le=60)
    """air temperature at the place of the start, in the shade; default: that of a standard day,
    with a spread of 15 K."""
    metar: str | None = Field(None, max_length=400)
    """METAR of the field of the take-off, such as "LSZH 281420Z 24008KT CAVOK 12/08 Q1013": its QNH
    and temperature, where qnh_hpa and temperature_c are not given."""

    field_elevation_m: float | None = Field(None, ge=-500, le=9000)
    """elevation of the field of the take-off, m above sea level: the height of a vehicle that rests
    there before its flight, good to 1 m; default: as GNSS shows."""

    reference: str | None = Field(None, max_length=200)
    """URL of a link to a ground barometer, a MAVLink sender at rest that sends SCALED_PRESSURE: its
    QNH is used as weather that is measured; needs reference_elevation_m"""
    reference_system_id: int | None = Field(None, ge=1, le=255)
    """MAVLink system id of the ground barometer; without `reference` it is heard on the vehicle's
    links and in recordings; default: whoever sends SCALED_PRESSURE on the link `reference`"""
    reference_elevation_m: float | None = Field(None, ge=-500, le=9000)
    """elevation of the ground barometer, m above sea level"""
    reference_sd_hpa: float = Field(1.0, gt=0, le=20)
    """standard deviation of the ground barometer's constant error, of the sensor and of its
    elevation; changes of its pressure are taken as they are"""

    @field_validator("metar")
    @classmethod
    def _tells_something(cls, metar: str | None) -> str | None:
        if metar is not None and read_metar(metar) == Report(None, None):
            raise ValueError("tells neither a pressure (Q1013, A2992) nor a temperature (12/08)")
        return metar

    @model_validator(mode="after")
    def _has_possible_qnh(self) -> "AirSettings":
        qnh_hpa = self.report.qnh_hpa
        if qnh_hpa is not None and not 850.0 <= qnh_hpa <= 1100.0:
            raise ValueError(f"metar: a QNH of {qnh_hpa:.0f} hPa is not possible; give 850 to 1100")
        return self

    @model_validator(mode="after")
    def _has_whole_reference(self) -> "AirSettings":
        given = self.reference is not None or self.reference_system_id is not None
        if given and self.reference_elevation_m is None:
            raise ValueError("reference_elevation_m: needed with reference or reference_system_id")
        if self.reference_elevation_m is not None and not given:
            raise ValueError("reference_elevation_m: give reference or reference_system_id too")
        return self

    @property
    def report(self) -> Report:
        """QNH and temperature: the keys, else those of the METAR."""
        read = read_metar(self.metar) if self.metar else Report(None, None)
        qnh_hpa = read.qnh_hpa if self.qnh_hpa is None else self.qnh_hpa
        return Report(
            qnh_hpa, read.temperature_c if self.temperature_c is None else self.temperature_c
        )


class Known(NamedTuple):
    """What an AIR sample tells; None is unknown."""

    temperature_c: float | None = None
    qnh_hpa: float | None = None
    field_elevation_m: float | None = None
    """of the field on which the vehicle rests now"""
    qnh_elevation_m: float | None = None
    """where the QNH was measured"""
    qnh_sd_pa: float | None = None
    """of a QNH that is measured now"""


# Looked up in its class, a member of an enum costs ten times as much (Python 3.11).
_STATUS = Kind.STATUS
_PRESSURE = Kind.PRESSURE


class KnownAir:
    """The values, and what of them the estimator has still to be told."""

    def __init__(self, settings: AirSettings) -> None:
        self.state: Rows = rows(KNOWN)
        self.qnh_hpa, self.temperature_c = settings.report
        self.field_elevation_m = settings.field_elevation_m
        self.reference: ReferenceBarometer | None = None
        if settings.reference_elevation_m is not None:
            self.reference = ReferenceBarometer(
                settings.reference_elevation_m, 100.0 * settings.reference_sd_hpa
            )
        self.at_rest = AtRest()
        self.restart()

    @property
    def field_elevation_m(self) -> float | None:
        """Elevation of the field on which the vehicle rests before its flight."""
        elevation_m = float(self.state["elevation_m"][0])
        return elevation_m if math.isfinite(elevation_m) else None

    @field_elevation_m.setter
    def field_elevation_m(self, elevation_m: float | None) -> None:
        self.state["elevation_m"] = math.nan if elevation_m is None else elevation_m

    def set(
        self,
        *,
        qnh_hpa: float | None = None,
        temperature_c: float | None = None,
        field_elevation_m: float | None = None,
        metar: str | None = None,
    ) -> None:
        """Replace what is given. `field_elevation_m` alone sets the altimeter to the pressure
        measured at rest. Raises `ConfigError`, in one line, for a value that is not possible."""
        given = {
            "qnh_hpa": qnh_hpa,
            "temperature_c": temperature_c,
            "field_elevation_m": field_elevation_m,
            "metar": metar,
        }
        live = validate(
            {k: v for k, v in given.items() if v is not None}, AirSettings, source="air"
        )
        report = live.report
        if report.temperature_c is not None:
            self.temperature_c = report.temperature_c
        if report.qnh_hpa is not None or live.field_elevation_m is not None:
            self.qnh_hpa, self.field_elevation_m = report.qnh_hpa, live.field_elevation_m
            self.at_rest.forget_flight()
        self.restart()

    def restart(self) -> None:
        """The estimator knows nothing any more: tell it again."""
        self.state["untold"] = self.qnh_hpa is not None or self.temperature_c is not None
        self.state["told_us"] = NEVER_US
        if self.reference is not None:
            self.reference.restart()

    def hear(self, pressure_pa: float | None, now_us: int) -> None:
        """A pressure of the reference barometer; None where its message holds none."""
        if self.reference is not None and pressure_pa is not None:
            self.reference.hear(pressure_pa, now_us)

    @property
    def problems(self) -> list[str]:
        """What is wrong with the reference barometer."""
        problem = self.reference.problem if self.reference is not None else ""
        return [problem] if problem else []

    def sample(self, kind: Kind, row: Rows) -> None:
        """Follow a sample, shape (1,), of the vehicle."""
        if kind is _STATUS or self.field_elevation_m is not None:
            self.at_rest.sample(kind, row)

    def due(self, kind: Kind, now_us: int, estimate: Rows) -> Known | None:
        """Before a pressure what to `tell`, with the QNH of the reference, which the `estimate` may
        contradict."""
        if kind is not _PRESSURE:
            return None
        known, reference = self.tell(now_us), self.reference
        qnh_pa = reference.tell(now_us, estimate) if reference is not None else None
        if reference is None or qnh_pa is None:
            return known
        return (known or Known())._replace(
            qnh_hpa=0.01 * qnh_pa,
            qnh_elevation_m=reference.elevation_m,
            qnh_sd_pa=reference.sd_pa,
        )

    def tell(self, now_us: int) -> Known | None:
        """What to tell with the pressure of now; None when the estimator knows it all."""
        known, elevation_m = Known(), self.field_elevation_m
        if not is_due(self.state, self.at_rest.state, now_us):
            return None
        if self.state["untold"][0]:
            at_m = elevation_m if self.qnh_hpa is not None else None
            known = Known(self.temperature_c, self.qnh_hpa, qnh_elevation_m=at_m)
            self.state["untold"] = 0
        if elevation_m is not None and is_elevation_due(self.state, self.at_rest.state, now_us):
            apart_m = self.at_rest.contradiction_m(now_us, elevation_m)
            self.state["warned"] = bool(apart_m)
            if apart_m:
                logger.warning(
                    "air.field_elevation_m %.0f m is not used: GNSS is %.0f m beside it",
                    elevation_m,
                    apart_m,
                )
            else:
                self.state["told_us"] = now_us
                known = known._replace(
                    field_elevation_m=elevation_m, temperature_c=self.temperature_c
                )
        return known if known != Known() else None


@step
def is_due(k: Rows, r: Rows, now_us: int) -> bool:
    """Whether there is something to tell with the pressure of now, or to warn of."""
    return k[0].untold == 1 or is_elevation_due(k, r, now_us)


@step
def is_elevation_due(k: Rows, r: Rows, now_us: int) -> bool:
    """Whether the elevation of the field is to be told now, or to be warned of."""
    told_us = k[0].told_us
    if math.isnan(k[0].elevation_m) or (told_us != NEVER_US and 0 <= now_us - told_us < AGAIN_US):
        return False
    if not rests(r, now_us):
        return False
    return k[0].warned == 0 or contradiction_m(r, now_us, k[0].elevation_m) == 0.0

"""What a ground station set of the air, kept for the next start on its request
(MAV_CMD_PREFLIGHT_STORAGE, see `companion.mavlink.commands`).

The elevation of a field stays; pressure and temperature of the air do not: they are used for
`FRESH_S`. What the configuration gives is not replaced.
"""

import contextlib
import hashlib
import json
import logging
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from companion import locations, whole_file
from companion.config import validate
from companion.errors import ConfigError
from companion.known_air import AirSettings, KnownAir

logger = logging.getLogger("kollsman.service")

FRESH_S = 3 * 3600.0
"""The weather moves the pressure by 1 hPa in some three hours, 8 m of height."""
KEYS = {
    "qnh_hpa": "QNH {:.1f} hPa",
    "temperature_c": "{:.1f} degC",
    "field_elevation_m": "{:.0f} m",
}
LASTING = frozenset({"field_elevation_m"})


class AirStore:
    """One file, for one set of links.

    Parameters
    ----------
    links : the canonical URLs that this process serves.
    directory : where; default `locations.state_directory`.
    wall_s : UNIX time.
    """

    def __init__(
        self,
        links: Sequence[str],
        directory: Path | None = None,
        wall_s: Callable[[], float] = time.time,
    ) -> None:
        folder = directory or locations.state_directory()
        name = hashlib.sha256("\n".join(links).encode()).hexdigest()[:16]
        self.path = folder / f"air-{name}.json" if folder is not None else None
        self._wall_s = wall_s

    def keep(self, air: KnownAir | None) -> bool:
        """Write what is known of the air, or remove the file where that is None; whether it
        worked."""
        if self.path is None:
            return False
        try:
            if air is None:
                with contextlib.suppress(FileNotFoundError):
                    self.path.unlink()
                return True
            values = {key: getattr(air, key) for key in KEYS}
            kept = json.dumps(values | {"unix_s": self._wall_s()})
            whole_file.write(self.path, kept.encode("ascii"))
        except OSError as error:
            logger.warning("parameters are not kept: %s", error)
            return False
        return True

    def restore(self, air: KnownAir, given: AirSettings) -> None:
        """Set in `air` what was kept and is not given in the configuration."""
        values = self._read()
        age_s = self._wall_s() - values.pop("unix_s", 0.0)
        if given.report.qnh_hpa is not None or given.field_elevation_m is not None:
            for key in ("qnh_hpa", "field_elevation_m"):  # one tells the other
                values.pop(key, None)
        taken = {
            key: value
            for key, value in values.items()
            if (key in LASTING or 0.0 <= age_s <= FRESH_S)
            and getattr(given.report, key, None) is None
        }
        if not taken:
            return
        try:
            known = validate(dict(taken), AirSettings, source=str(self.path))
        except ConfigError as error:
            logger.warning("kept parameters not used: %s", error)
            return
        air.set(
            qnh_hpa=known.qnh_hpa,
            temperature_c=known.temperature_c,
            field_elevation_m=known.field_elevation_m,
        )
        listed = ", ".join(KEYS[key].format(value) for key, value in taken.items())
        logger.info("kept by a ground station %.1f h ago: %s", age_s / 3600.0, listed)

    def _read(self) -> dict[str, float]:
        """The numbers of the file; none where there is none or it is no such file."""
        if self.path is None:
            return {}
        try:
            found = json.loads(self.path.read_text(encoding="ascii"))
            return {
                key: float(found[key])
                for key in (*KEYS, "unix_s")
                if isinstance(found.get(key), int | float)
            }
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, AttributeError) as error:
            logger.warning("kept parameters not used: %s", error)
            return {}

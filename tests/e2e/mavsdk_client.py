"""MAVSDK's side of test_interop: run in MAVSDK's own environment, prints what it found as one line
of JSON.

python mavsdk_client.py CONNECTION_URL PARAMETER
"""

import json
import sys
import time
from collections.abc import Callable
from typing import Any

from mavsdk import ComponentType, Configuration, ConnectionResult, Mavsdk  # type: ignore[import-not-found]
from mavsdk.plugins.info import Info  # type: ignore[import-not-found]
from mavsdk.plugins.param import Param  # type: ignore[import-not-found]
from mavsdk.plugins.telemetry import Telemetry  # type: ignore[import-not-found]

PATIENCE_S = 20.0


def until(value: Callable[[], Any], good: Callable[[Any], bool]) -> Any:
    """`value()` as soon as it is good, or what it is when patience ends. MAVSDK raises until it has
    heard some."""
    deadline_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            found = value()
            if good(found):
                return found
        except Exception as error:
            found = error
        if time.monotonic() > deadline_s:
            return found
        time.sleep(0.1)


def main(url: str, parameter: str) -> dict[str, Any]:
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    result = mavsdk.add_any_connection(url)
    if result != ConnectionResult.SUCCESS:
        return {"error": f"no connection: {result}"}
    system = mavsdk.first_autopilot(PATIENCE_S)
    if system is None:
        return {"error": "no autopilot found"}
    telemetry, param, info = Telemetry(system), Param(system), Info(system)
    seen = until(telemetry.position, lambda position: position.absolute_altitude_m > 1.0)
    version = until(info.get_version, lambda version: version.flight_sw_major > 0)
    before = until(lambda: param.get_param_float(parameter), lambda value: True)
    param.set_param_float(parameter, 12.5)
    everything = until(param.get_all_params, lambda found: len(found.float_params) > 0)
    altitude = (
        until(telemetry.altitude, lambda found: found.altitude_amsl_m > 1.0)
        if system_is_px4(system)
        else None
    )
    return {
        "system_id": system.get_system_id(),
        "components": sorted(system.component_ids()),
        "autopilot": int(system.autopilot_type()),
        "mode": int(telemetry.flight_mode()),
        "latitude_deg": seen.latitude_deg,
        "absolute_altitude_m": seen.absolute_altitude_m,
        "version": [version.flight_sw_major, version.flight_sw_minor],
        "before": before,
        "parameters": {
            row.name: row.value for row in [*everything.float_params, *everything.int_params]
        },
        "altitude_amsl_m": altitude.altitude_amsl_m if altitude else None,
        "altitude_monotonic_m": altitude.altitude_monotonic_m if altitude else None,
    }


def system_is_px4(system: Any) -> bool:
    return int(system.autopilot_type()) == 1


if __name__ == "__main__":
    sys.stdout.write("FOUND " + json.dumps(main(*sys.argv[1:])) + "\n")
    sys.stdout.flush()

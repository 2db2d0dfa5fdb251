"""Kollsman's simulator: JSBSim flies an aircraft through weather, and a simulated autopilot sends
MAVLink.

Data path, in lockstep (`flight.Flight`)::

    weather -> aircraft (JSBSim, 200 Hz) -> autopilot (50 Hz)
                   |-> truth --------------------------------------------.
                   `-> sensors (barometer, gnss, imu) -> vehicle -> ports: tlog, links
                                                            ^
                                       commands, ALTITUDE --'

Units, frames and names are those of `companion.__init__`. Two places convert units: ``aircraft.py``
(JSBSim's feet and slugs) and ``vehicle/ardupilot.py`` with ``px4.py`` (MAVLink's integers).

Time
----
Everything runs on simulated time: ``time_us`` counts from the vehicle's boot, in ticks of
`TICK_US`. Nothing but the pacing in ``flight.py`` reads the host's clock, so the same seed gives
the same bytes.
"""

STEP_HZ = 200
"""Rate of the flight dynamics."""

TICK_US = 10_000
"""The scheduler's tick: two steps of the dynamics. 20 Hz pressure and 50 Hz IMU both are whole
numbers of ticks."""

STEPS_PER_TICK = STEP_HZ * TICK_US // 1_000_000

BOOT_UNIX_US = 1_767_225_600_000_000
"""UNIX time of every simulated boot: 2026-01-01T00:00:00Z. A constant, so that logs repeat to the
byte."""

"""Kollsman's simulator: JSBSim flies a real aircraft model through weather and speaks MAVLink as an
autopilot would.

Data path, in lockstep (`flight.Flight`)::

    weather -> aircraft (JSBSim, 200 Hz) -> autopilot (50 Hz)
                   |-> truth --------------------------------------------.
                   `-> sensors (barometer, gnss, imu) -> vehicle -> ports: tlog, links
                                                            ^
                                       commands, ALTITUDE --'

Units, frames and names are those of `companion.__init__`. Two borders translate: ``aircraft.py``
(JSBSim's feet and slugs) and ``telemetry.py`` with ``px4.py`` (MAVLink's integers).

Time
----
Everything runs on simulated time: ``time_us`` counts from the vehicle's boot, in ticks of `TICK_US`. Nothing but the
pacing in ``flight.py`` reads the host's clock, so the same seed gives the same bytes.

Modules
-------
==================  ===================================================================================
``aircraft``        JSBSim: the only file with its property names and US units
``autopilot``       take-off, climb on airspeed, altitude hold, descent on vertical speed, flare
``gains``           speeds and loop gains, one set an aircraft
``stall``           ends a flight whose wing no longer carries
``approach``        centre line, glide path, flare, roll-out
``weather``         pressure, temperature and wind over place and time; layers of air; METARs
``sensors``         barometer, GNSS receiver, IMU: one random stream each
``estimate``        the vehicle's own position estimate (GLOBAL_POSITION_INT), barometric as EKF3's
``telemetry``       messages out of the vehicle's state
``px4``             those of PX4
``flavours``        whose autopilot it looks like: messages, parameters, answers
``parameters``      tables of parameters, and what a PARAM_SET does
``routing``         what goes on from one link to others
``frames``          fast MAVLink 2 packing
``profile``         the legs of a flight, and the sequence that makes targets of them
``ports``           one a link or log: what it is sent, how often, and how much it was
``vehicle``         the MAVLink face: streams, commands, what the companion sends back
``scenario``        the typed scenario file
``faults``          what goes wrong on the way, on simulated and on recorded streams alike
``corrupt``         a log with faults
``flight``          the loop, its pace, and the summary
``papers``          the published systems' simulations, and pages of printed against ours
``cli``             the command ``kollsman-sim``
==================  ===================================================================================
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

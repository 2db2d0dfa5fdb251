"""Compile everything a run needs before the first packet matters: a made-up vehicle goes through a
pipeline."""

import logging
import math
import os

from companion.estimators import DEFAULT_ESTIMATOR, ESTIMATORS, run_log
from companion.jobs import executor_of, results, run
from companion.mavlink.codec import Encoder, Message, mavlink
from companion.output import quiet
from companion.pipeline import Pipeline
from companion.samples import Packet, SampleLog
from companion.settings import CompanionSettings

COMPILING = "compiling the estimators, once after an installation or an update"
SECONDS = 4
RATE_HZ = 4


def warm_up(settings: CompanionSettings) -> None:
    """Run a few seconds of a vehicle that stands still through a throw-away pipeline."""
    with quiet(logging.ERROR):
        pipeline = Pipeline(settings)
        vehicle = Encoder(settings.vehicle.system_id or 1, 1)
        for tick in range(SECONDS * RATE_HZ):
            boot_ms = 1000 + tick * 1000 // RATE_HZ
            messages = [
                mavlink.MAVLink_heartbeat_message(
                    1, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 3, 3
                ),
                mavlink.MAVLink_attitude_message(boot_ms, 0, 0, 0, 0, 0, 0),
                mavlink.MAVLink_raw_imu_message(boot_ms * 1000, 0, 0, -1000, 0, 0, 0, 0, 0, 0),
                mavlink.MAVLink_scaled_pressure_message(boot_ms, 1013.25, 0.0, 2500),
                mavlink.MAVLink_gps_raw_int_message(
                    boot_ms * 1000, 3, 1, 1, 500, 100, 150, 0, 0, 10, 17_500, 1000, 2000, 100, 0
                ),
            ]
            if tick == SECONDS * RATE_HZ - 1:
                messages += rare_messages(boot_ms)
            for message in messages:
                pipeline.feed(Packet(boot_ms * 1000, vehicle.encode(message)))
        pipeline.flush(0)
    if not math.isfinite(float(pipeline.estimate["altitude_amsl_m"][0])):
        raise AssertionError("the warm-up did not reach an estimate")


def rare_messages(boot_ms: int) -> list[Message]:
    """Messages with steps of their own that may come for the first time in flight."""
    return [
        mavlink.MAVLink_distance_sensor_message(boot_ms, 10, 5000, 100, 0, 0, 25, 0),
        mavlink.MAVLink_home_position_message(1, 1, 500, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0),
        mavlink.MAVLink_system_time_message(1_700_000_000_000_000, boot_ms),
        mavlink.MAVLink_vfr_hud_message(0, 0, 0, 0, 0, 0),
        mavlink.MAVLink_global_position_int_message(boot_ms, 1, 1, 500, 0, 0, 0, 0, 0),
        mavlink.MAVLink_altitude_message(boot_ms * 1000, 0, 0, 0, 0, 0, 0),
    ]


def warm_up_everything() -> None:
    """Compile every estimator, and the loops over a whole log, on all cores."""
    longest_first = [DEFAULT_ESTIMATOR, *(set(ESTIMATORS) - {DEFAULT_ESTIMATOR})]
    with executor_of(os.cpu_count() or 1) as executor:
        results(run(warm_up_with_loops, longest_first, executor, key=str))


def warm_up_with_loops(name: str) -> str:
    """Compile an estimator, its loop over a whole log, and those around it."""
    warm_up(CompanionSettings().with_changes(estimator=name))
    run_log(ESTIMATORS[name], SampleLog())
    warm_up_blocks()
    return name


def warm_up_blocks() -> None:
    """Compile the loops of a replay around the estimator's."""
    from companion.replay.blocks import BlockRunner

    BlockRunner(Pipeline(CompanionSettings(), sends=False), lambda *_: []).compile()

"""The records of a pipeline on which the compiled steps of a reading work
(`companion.reading_steps`): its own, not copies."""

from typing import TYPE_CHECKING

from companion.reading_steps import Following, Intaking
from companion.samples import Kind

if TYPE_CHECKING:
    from companion.pipeline import Pipeline


def intaking_of(pipeline: "Pipeline") -> Intaking:
    """State and parameters of the intake."""
    intake = pipeline.intake
    one, two, three, four = (receiver.state for receiver in intake.receivers)
    pressure, gnss = (intake.primaries[kind].state for kind in (Kind.PRESSURE, Kind.GNSS))
    return Intaking(
        intake.clock.state,
        intake.clock.params,
        intake.state,
        intake.params,
        pipeline.readings.imu.state,
        intake.datum.state,
        intake.datum.params,
        pipeline.air.state,
        pipeline.air.at_rest.state,
        intake.simulation.state,
        (one, two, three, four),
        (pressure, gnss),
    )


def following_of(pipeline: "Pipeline") -> Following:
    """State and parameters of what follows a sample."""
    outputs = pipeline.outputs
    return Following(
        pipeline.checker.sensors.state,
        pipeline.checker.state,
        pipeline.health.state,
        pipeline.health.params,
        outputs.state,
        outputs.params,
        outputs.monotonic.state,
        outputs.leap.state,
        outputs.heights,
    )


def owners_of(pipeline: "Pipeline") -> tuple[object, ...]:
    """What owns these records: where one is another object, so are its records."""
    intake = pipeline.intake
    return (
        intake,
        *intake.receivers,
        pipeline.readings,
        pipeline.checker,
        pipeline.checker.sensors,
        pipeline.health,
        pipeline.outputs,
        pipeline.filter,
        pipeline.air,
    )

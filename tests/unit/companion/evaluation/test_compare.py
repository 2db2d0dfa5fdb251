"""`kollsman compare`: one table for every estimator and the raw sensors."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from companion.estimators import ESTIMATORS
from companion.evaluation.compare import compare
from companion.evaluation.samples import samples_of
from companion.plots.comparison import plot
from companion.samples import Kind


def test_every_estimator_and_the_raw_sensors_are_held_against_truth(
    short_hop: Path, tmp_path: Path
) -> None:
    done: list[float] = []
    found = compare(short_hop, on_progress=done.append)
    labels = [result.label for result in found.results]
    assert labels == [*ESTIMATORS, "autopilot's own", "raw GNSS", "raw barometer"]
    assert found.reference == "truth"
    assert done[-1] == pytest.approx(1.0)
    by_label = {result.label: result for result in found.results}
    assert by_label["raw barometer"].baro_residual_m == pytest.approx(0.0, abs=1e-9)
    for name in ESTIMATORS:
        assert np.isfinite(
            [by_label[name].rmse_m, by_label[name].nees, by_label[name].cost_us]
        ).all()
    json.dumps(found.as_dict(), allow_nan=False)
    picture = tmp_path / "errors.png"
    plot(found, picture, "short hop")
    assert picture.stat().st_size > 10_000


def test_without_truth_the_smoother_is_the_reference(short_hop: Path, tmp_path: Path) -> None:
    from companion.logs.tlog import TlogReader, TlogWriter
    from companion.mavlink.codec import mavlink, scan

    blind = tmp_path / "blind.tlog"
    with TlogWriter(blind) as writer:
        for packet in TlogReader(short_hop):
            frame = scan(packet.data, 0)
            if getattr(frame, "message_id", None) != mavlink.MAVLINK_MSG_ID_SIM_STATE:
                writer.write(packet.time_us, packet.data)
    found = compare(blind)
    assert found.reference == "smoother"
    by_label = {result.label: result for result in found.results}
    assert by_label["raw GNSS"].rmse_m > 0.1  # raw GNSS is not its own truth
    assert math.isnan(by_label["vertical-bank"].nees)


def test_samples_of_a_log_keep_order_and_truth(short_hop: Path) -> None:
    log = samples_of(short_hop)
    assert len(log) == sum(len(log[kind]) for kind in Kind)
    assert log.truth.size > 4000
    assert log.autopilot.size > 1000
    stamps = np.asarray(log[Kind.PRESSURE]["time_us"])
    assert (np.diff(stamps) > 0).all()

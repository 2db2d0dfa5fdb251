"""Dataflash columns against pymavlink's reader of the same files, and damage."""

import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink import DFReader

from companion.logs import open_log
from companion.logs.dataflash import BinReader, TextReader, read_bin, read_text
from companion.mavlink.codec import FrameReject
from companion.samples import Kind
from tests import logfiles
from tests.paths import DATA, ROOT

REAL = sorted([*DATA.glob("real/*.bin"), *DATA.glob("real/*.log")])
REAL_PARAMS = [pytest.param(path, id=path.stem) for path in REAL]


def oracle(path: Path) -> dict[str, list[Any]]:
    is_text = path.suffix == ".log"
    reader = DFReader.DFReader_text(str(path)) if is_text else DFReader.DFReader_binary(str(path))
    found: dict[str, list[Any]] = {}
    while (message := reader.recv_msg()) is not None:
        found.setdefault(message.get_type(), []).append(message)
    reader.data_map.close()
    reader.filehandle.close()
    return found


def same_as_oracle(path: Path) -> None:
    expected = oracle(path)
    if path.suffix == ".log":
        columns, _ = read_text(path.read_text(encoding="ascii", errors="replace"))
    else:
        columns, _ = read_bin(np.fromfile(path, np.uint8))
    for name in set(expected) - {"FMT", "FMTU", "UNIT", "MULT", "ISBD", "PARM"}:
        rows = expected[name]
        fields = columns[name].fields
        assert columns[name].place.size == len(rows), name
        for label, found in fields.items():
            if found.dtype.kind not in "iuf" or found.ndim > 1:
                continue
            told = [getattr(row, label) for row in rows]
            if any(isinstance(value, str) for value in told):
                continue  # a mode's name, where the log has its number
            np.testing.assert_allclose(
                found.astype(float), np.array(told, float), rtol=1e-9, err_msg=f"{name}.{label}"
            )


@pytest.mark.parametrize("path", REAL_PARAMS)
def test_columns_of_real_logs(path: Path) -> None:
    same_as_oracle(path)


def test_columns_of_a_generated_log(tmp_path: Path) -> None:
    path, _ = logfiles.write("bin", tmp_path, duration_s=20.0)
    same_as_oracle(path)


def test_accuracies_and_vertical_velocity_are_of_their_fix(tmp_path: Path) -> None:
    path, made = logfiles.write("bin", tmp_path, duration_s=30.0, gnss_sd_m=2.5)
    reader = BinReader(path)
    gnss = next(table for table in reader.tables.sensors if table.kind is Kind.GNSS)
    names = ("climb_mps", "horizontal_sd_m", "vertical_sd_m")
    climb, horizontal, vertical = (gnss.samples[name] for name in names)
    assert np.isnan(climb).all()  # GPA.VV is 0: the receiver does not measure it
    np.testing.assert_allclose(vertical, 2.5)
    np.testing.assert_allclose(horizontal, 1.0)
    assert gnss.places.size == made.tables[Kind.GNSS].size


def test_damage_costs_only_what_it_hits(tmp_path: Path) -> None:
    path, _ = logfiles.write("bin", tmp_path, duration_s=60.0)
    whole = BinReader(path).tables
    data = bytearray(path.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 400] = bytes(400)
    path.write_bytes(bytes(data))
    reader = BinReader(path)
    assert 300 < reader.counters[FrameReject.JUNK] < 600
    lost = sum(t.places.size for t in whole.sensors) - sum(
        t.places.size for t in reader.tables.sensors
    )
    assert 0 < lost < 20


def test_what_the_autopilot_said(tmp_path: Path) -> None:
    for name in ("bin", "log"):
        path, made = logfiles.write(name, tmp_path, duration_s=10.0)
        reader = open_log(path)
        assert isinstance(reader, BinReader | TextReader)
        tables = reader.tables
        assert tables.system_id == 7
        assert tables.armed == [(made.start_us, True)]
        assert tables.texts[0][1].startswith("ArduPlane")
        assert tables.modes == [(made.start_us, "10")]
        epoch_us = (315_964_800 - 18 + 2286 * 604_800) * 1_000_000 + 302_400_000_000
        assert math.isclose(tables.utc_offset_us, epoch_us, abs_tol=2000)


def test_readers_need_no_dialect_but_ours() -> None:
    """pymavlink.mavutil loads all dialects, which the images do not hold."""
    code = "import sys, companion.logs; sys.exit('pymavlink.mavutil' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0

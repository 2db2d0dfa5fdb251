"""Checkpoints: the state of the pipeline, written every few seconds, to continue after a kill.

A process that is killed in flight and started again within `CheckpointSettings.fresh_s` continues
from its last checkpoint instead of starting anew. A checkpoint is used only by the same code with
the same configuration on the same links, and only while the computer has not been restarted in
between. It is deleted when it is read: a state that makes the process end is tried once.

What is written is a pickle, which may name only the classes listed here; the file is readable by
its owner alone, and one of another owner is ignored. Nothing here ever raises.
"""

import contextlib
import hashlib
import io
import logging
import os
import pickle
import time
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from companion import locations, whole_file
from companion.checkpoint_settings import CheckpointSettings
from companion.estimators import Filter
from companion.health import Health
from companion.pipeline import Pipeline

logger = logging.getLogger("kollsman.checkpoint")

MAGIC = b"kollsman checkpoint 1\n"
PARTS = ("identity", "intake", "health", "outputs", "heard", "readings")
"""Attributes of the pipeline that continue, besides the estimator's state."""
OPTIONAL_PARTS = ("checker", "announcements", "air")
STANDARD_CLASSES = frozenset(
    {
        ("collections", "Counter"),
        ("collections", "deque"),
        ("collections", "OrderedDict"),
        ("builtins", "set"),
        ("builtins", "frozenset"),
        ("builtins", "range"),
        ("numpy", "ndarray"),
        ("numpy", "dtype"),
        ("numpy", "record"),
        ("numpy", "recarray"),
        ("numpy.core.multiarray", "_reconstruct"),
        ("numpy.core.multiarray", "scalar"),
        ("numpy._core.multiarray", "_reconstruct"),
        ("numpy._core.multiarray", "scalar"),
        ("numpy.core.numeric", "_frombuffer"),
        ("numpy._core.numeric", "_frombuffer"),
    }
)
LARGEST_BYTES = 20_000_000
DISAGREEMENT_US = 3_000_000
NOT_HEARD_US = 3_000_000


class Checkpoint:
    """One file with the newest state.

    Parameters
    ----------
    links : the canonical URLs that this process serves; processes on other links have other files.
    directory : where; default `locations.runtime_directory`. None there: no checkpoints.
    """

    def __init__(
        self,
        settings: CheckpointSettings,
        links: Sequence[str],
        fingerprint: str,
        directory: Path | None = None,
    ) -> None:
        self._settings = settings
        self._fingerprint = fingerprint
        folder = directory or locations.runtime_directory()
        name = hashlib.sha256("\n".join(links).encode()).hexdigest()[:16]
        self.path = folder / f"{name}.state" if folder is not None else None
        self._due_s = 0.0
        self._failed = False

    def save(self, pipeline: Pipeline) -> bool:
        """Write the state when due, unless there is no usable altitude; whether it was written."""
        now_s = time.monotonic()
        if self.path is None or self._failed or not self._settings.period_s or now_s < self._due_s:
            return False
        self._due_s = now_s + self._settings.period_s
        if pipeline.health.health is Health.LOST or not pipeline.filter.is_valid:
            return False
        try:
            self._write(self.path, _pack(pipeline, self._fingerprint))
        except (OSError, pickle.PicklingError, TypeError, AttributeError) as error:
            self._failed = True
            logger.warning("no checkpoints: %s", error)
            return False
        return True

    def restore(self, pipeline: Pipeline) -> "Resumption | None":
        """Continue `pipeline` from the file if it is fresh; None when it starts anew."""
        if self.path is None or not self._settings.period_s:
            return None
        data = self._read(self.path)
        with contextlib.suppress(OSError):
            self.path.unlink()
        if data is None:
            return None
        try:
            state = _Unpickler(io.BytesIO(data)).load()
            age_s = _boot_s() - state["boot_s"]
            if state["fingerprint"] != self._fingerprint or state["boot_id"] != _boot_id():
                return None
            if not 0.0 <= age_s <= self._settings.fresh_s:
                logger.info("the last checkpoint is %.0f s old: starting anew", age_s)
                return None
            fresh = {name: getattr(pipeline, name) for name in ("filter", *state["parts"])}
            restored = Filter(pipeline.filter.method, pipeline.filter.settings)
            restored.restore(state["filter"])
            age_us = round(age_s * 1e6)
            state["parts"]["health"].shift(age_us)
            vars(pipeline).update(state["parts"] | {"filter": restored})
        except Exception as error:  # a file from outside must not stop the start
            logger.warning("checkpoint not used: %s", error)
            return None
        logger.info("continuing from a checkpoint %.1f s old", age_s)
        return Resumption(pipeline, fresh, pipeline.now_us + age_us)

    def _write(self, path: Path, data: bytes) -> None:
        content = MAGIC + zlib.crc32(data).to_bytes(4, "little") + data
        whole_file.write(path, content, mode=0o600)

    def _read(self, path: Path) -> bytes | None:
        try:
            with path.open("rb") as file:
                if os.fstat(file.fileno()).st_uid != os.getuid():
                    return None
                content = file.read(LARGEST_BYTES)
        except OSError:
            return None
        head = len(MAGIC) + 4
        data = content[head:]
        expected = content[:head]
        if expected != MAGIC + zlib.crc32(data).to_bytes(4, "little"):
            logger.warning("checkpoint not used: %s is damaged", path)
            return None
        return data


class Resumption:
    """Whether the vehicle heard after a restart is the one of the checkpoint: its clock must have
    gone on as the host's did.

    Parameters
    ----------
    pipeline : continues from the checkpoint.
    fresh : its attributes before, for a new start.
    expected_us : what the vehicle's clock should say now.
    """

    def __init__(self, pipeline: Pipeline, fresh: dict[str, Any], expected_us: int) -> None:
        self._pipeline = pipeline
        self._fresh = fresh
        self._restored_us = pipeline.now_us
        self._expected_us = expected_us
        self._started_us: int | None = None
        self.settled = False
        """whether the question is answered"""

    def check(self, now_us: int) -> None:
        """Start anew after all, where what is heard contradicts the checkpoint. `now_us` is the
        host's clock."""
        if self.settled:
            return
        if self._started_us is None:
            self._started_us = now_us
        elapsed_us, vehicle_us = now_us - self._started_us, self._pipeline.now_us
        if vehicle_us != self._restored_us:
            self.settled = True
            if abs(vehicle_us - self._expected_us - elapsed_us) > DISAGREEMENT_US:
                self._undo("the vehicle's clock did not go on")
        elif self._pipeline.decoder.frames and elapsed_us > NOT_HEARD_US:
            self.settled = True
            self._undo("the vehicle of the checkpoint is not heard")

    def _undo(self, why: str) -> None:
        logger.warning("starting anew after all: %s", why)
        vars(self._pipeline).update(self._fresh)


def fingerprint(settings: Any) -> str:
    """A hash of the code and the configuration."""
    digest = hashlib.sha256(settings.model_dump_json().encode())
    package = Path(__file__).parent
    for path in sorted(package.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _pack(pipeline: Pipeline, mark: str) -> bytes:
    parts = {name: getattr(pipeline, name) for name in PARTS}
    parts |= {name: getattr(pipeline, name) for name in OPTIONAL_PARTS if hasattr(pipeline, name)}
    state = {
        "fingerprint": mark,
        "boot_id": _boot_id(),
        "boot_s": _boot_s(),
        "filter": pipeline.filter.checkpoint(),
        "parts": parts,
    }
    return pickle.dumps(state, protocol=5)


class _Unpickler(pickle.Unpickler):
    """Makes objects of this package's own classes, of NumPy arrays and of a few containers only."""

    def find_class(self, module: str, name: str) -> Any:
        own = module.startswith("companion.") and "." not in name
        if own or (module, name) in STANDARD_CLASSES:
            found = super().find_class(module, name)
            if isinstance(found, type) or not own:
                return found
        raise pickle.UnpicklingError(f"{module}.{name} does not belong in a checkpoint")


def _boot_s() -> float:
    """Seconds since the computer was started, asleep or not: steps of the wall clock do not
    count."""
    return time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))


def _boot_id() -> str:
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii")
    except OSError:
        return ""

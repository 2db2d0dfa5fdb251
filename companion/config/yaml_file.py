"""Reads YAML text within a bounded time and size, and finds the lines of its keys."""

import io
import os
import select
import stat
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from companion.errors import ConfigError

READ_S = 1.0
LONGEST_BYTES = 200_000
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times faster, where it was built


def read(path: Path) -> tuple[dict[str, Any], yaml.Node | None]:
    """The values of a file, and its nodes, which know their lines.

    Raises `ConfigError` for a file that cannot be read, is no YAML, or gives a key twice.
    """
    text = _text_of(path)
    root: yaml.Node | None = None
    try:
        root = yaml.compose(text, Loader=_LOADER)
        values = yaml.load(text, Loader=_LOADER)
    except yaml.YAMLError as error:
        raise ConfigError(_yaml_problem(path, text, error)) from None
    except RecursionError:
        raise ConfigError(f"{path}: not valid YAML: nested too deeply") from None
    except ValueError as error:  # a date such as 2001-99-99, an integer of thousands of digits
        raise ConfigError(f"{path}:{_line_of_bad_value(root)}: not valid YAML: {error}") from None
    _refuse_duplicates(path, root)
    values = {} if values is None else values
    if not isinstance(values, dict):
        raise ConfigError(f"{path}: must hold `key: value` lines, found a {type(values).__name__}")
    return values, root


def _text_of(path: Path) -> str:
    """The text of a file or of a pipe such as the shell's ``<(command)``, within `READ_S`.

    Raises `ConfigError` for what is not text, has no end, or is longer than any configuration.
    """
    try:
        with open(path, "rb", buffering=0, opener=_without_waiting) as file:
            data = _read_bounded(file, deadline_s=time.monotonic() + READ_S)
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except TimeoutError:
        raise ConfigError(f"{path}: did not end within {READ_S:g} s; name a regular file") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read as text: {error}") from None
    if len(data) > LONGEST_BYTES:
        raise ConfigError(
            f"{path}: is longer than {LONGEST_BYTES} bytes, so it is no configuration file"
        )
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: cannot be read as text: {error}") from None


def _without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK)


def _read_bounded(file: io.FileIO, deadline_s: float) -> bytes:
    """At most one byte more than `LONGEST_BYTES`. A pipe whose writer is not there yet is waited
    for. Raises TimeoutError at the deadline."""
    is_pipe = stat.S_ISFIFO(os.fstat(file.fileno()).st_mode)
    data = b""
    while len(data) <= LONGEST_BYTES:
        left_s = deadline_s - time.monotonic()
        if left_s <= 0.0 or not select.select([file], [], [], left_s)[0]:
            raise TimeoutError
        chunk = file.read(LONGEST_BYTES + 1 - len(data))
        if chunk:
            data += chunk
        elif data or not is_pipe:
            break
        else:
            time.sleep(0.02)
    return data


def _yaml_problem(path: Path, text: str, error: yaml.YAMLError) -> str:
    """One line for a file that is not YAML."""
    mark = getattr(error, "problem_mark", None)
    line = mark.line + 1 if mark else text.count("\n", 0, getattr(error, "position", 0)) + 1
    parts = [getattr(error, name, None) for name in ("context", "problem", "reason")]
    problem = ": ".join(" ".join(str(part).split()) for part in parts if part)
    return f"{path}:{line}: not valid YAML: {problem or 'unreadable'}"


def line_of(node: yaml.Node | None, location: tuple[int | str, ...]) -> int | None:
    """The line of the key at `location`, or of the last part of it that is in the file."""
    line = None
    for part in location:
        if isinstance(node, yaml.MappingNode):
            pair = next(((key, value) for key, value in node.value if key.value == str(part)), None)
            if pair is None:
                break
            line, node = pair[0].start_mark.line + 1, pair[1]
        elif (
            isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value)
        ):
            node = node.value[part]
            line = node.start_mark.line + 1
        else:
            break
    return line


def _nodes(root: yaml.Node | None) -> Iterator[yaml.Node]:
    """Every node once, even of an anchor that contains itself."""
    waiting, visited = [root], set()
    while waiting:
        node = waiting.pop()
        if node is None or id(node) in visited:
            continue
        visited.add(id(node))
        yield node
        if isinstance(node, yaml.MappingNode):
            waiting += [part for pair in reversed(node.value) for part in reversed(pair)]
        elif isinstance(node, yaml.SequenceNode):
            waiting += reversed(node.value)


def _line_of_bad_value(root: yaml.Node | None) -> int:
    """The line of the first value that looks like a date or a number and is none."""
    constructor = yaml.SafeLoader("")
    for node in _nodes(root):
        if isinstance(node, yaml.ScalarNode):
            try:
                constructor.construct_object(node)
            except ValueError:
                return int(node.start_mark.line) + 1
    return 1


def _refuse_duplicates(path: Path, root: yaml.Node | None) -> None:
    """YAML lets a later key silently win over an earlier one; a configuration must not."""
    for node in _nodes(root):
        if not isinstance(node, yaml.MappingNode):
            continue
        seen: set[str] = set()
        for key, _ in node.value:
            if key.value in seen:
                raise ConfigError(f"{path}:{key.start_mark.line + 1}: {key.value}: given twice")
            seen.add(key.value)

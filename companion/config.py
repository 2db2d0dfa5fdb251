"""Typed YAML: every key optional, defaults in code beside what they tune, one clear line for every
mistake.

A section of a file is a `Settings` model that lives in the module it tunes; `load` reads a file
into one. The unit of a value is the suffix of its key, its range is declared with ``Field(ge=...,
le=...)``, and both appear in the error:

    companion.yaml:7: publish.altitude_hz: 500 is out of range; give a number from 0.1 to 100 (Hz)
"""

import difflib
import io
import os
import reprlib
import select
import stat
import time
from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from companion.errors import ConfigError

UNITS = {
    "_m": "m", "_mps": "m/s", "_mps2": "m/s2", "_radps": "rad/s", "_rad": "rad", "_deg": "degrees",
    "_pa": "Pa", "_hpa": "hPa", "_hpa_per_h": "hPa/h", "_k": "K", "_s": "s", "_us": "us",
    "_hz": "Hz", "_mb": "MB", "_m2": "m2", "_m2ps": "m2/s", "_m2ps3": "m2/s3",
    "_mps2_rthz": "m/s2/sqrt(Hz)", "_radps_rthz": "rad/s/sqrt(Hz)", "_rts": "1/sqrt(s)",
    "_m_rts": "m/sqrt(s)", "_mps2_rts": "m/s2/sqrt(s)", "_radps_rts": "rad/s/sqrt(s)", "_h": "h",
    "_pa_per_k": "Pa/K", "_pa_per_g": "Pa/g", "_m_per_h": "m/h", "_pa_per_s": "Pa/s",
    "_pa_rts": "Pa/sqrt(s)", "_mps2_per_k": "m/s2/K", "_radps_per_k": "rad/s/K",
    "hpa_per_100km": "hPa/100 km",
}  # fmt: skip


READ_S = 1.0
LONGEST_BYTES = 200_000
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times faster, where it was built

_NUMBERS = (float, int, float | None, int | None)


class Settings(BaseModel):
    """Base of every section: unknown keys are errors, values do not change after loading."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        str_strip_whitespace=True,
        use_attribute_docstrings=True,
    )

    @model_validator(mode="before")
    @classmethod
    def _as_written(cls, values: Any) -> Any:
        """An empty section has its defaults; yes and no are no numbers, though Python thinks so."""
        if not isinstance(values, dict):
            return values
        values = dict(values)
        for name, field in cls.model_fields.items():
            key, kind = field.alias or name, field.annotation
            value = values.get(key)
            if (
                value is None
                and key in values
                and isinstance(kind, type)
                and issubclass(kind, BaseModel)
            ):
                values[key] = {}
            elif isinstance(value, bool) and kind in _NUMBERS:
                values[key] = "yes" if value else "no"
        return values


Model = TypeVar("Model", bound=BaseModel)


def load(path: Path | str, model: type[Model]) -> Model:
    """Read the YAML file at `path` into `model`.

    Raises
    ------
    ConfigError
        One line: file, line, key, what was given, what is allowed and in which unit.
    """
    path = Path(path)
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
    return validate(values, model, source=str(path), root=root)


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


def validate(
    values: dict[str, Any], model: type[Model], source: str, root: yaml.Node | None = None
) -> Model:
    """Check `values` against `model`; `source` names their origin in the error."""
    try:
        return model.model_validate(values)
    except ValidationError as failure:
        at: dict[
            tuple[int | str, ...], list[ErrorDetails]
        ] = {}  # where in the file -> what is wrong there
        for error in failure.errors():
            at.setdefault(_location(error["loc"], model), []).append(error)
        location = min(at, key=lambda location: _line_of(root, location) or 0)
        line, errors = _line_of(root, location), at[location]
        place = f"{source}:{line}" if line else source
        said = (
            _explain(errors[0], model)
            if len(errors) == 1
            else _explain_union(errors, location, model)
        )
        more = f" (and {len(at) - 1} more)" if len(at) > 1 else ""
        raise ConfigError(f"{place}: {said}{more}") from None


def dump(model: BaseModel) -> str:
    """The resolved configuration as YAML."""
    return yaml.safe_dump(
        model.model_dump(mode="json", by_alias=True), sort_keys=False, allow_unicode=True
    )


def keys(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, str, str, str, str]]:
    """Every key of a file of this model: (dotted key, default, unit, allowed, meaning)."""
    for name, field in model.model_fields.items():
        key = f"{prefix}{field.alias or name}"
        section = _model_in(field.annotation)
        if section is not None:
            yield from keys(section, f"{key}.")
            continue
        default = field.get_default(call_default_factory=True)
        meaning = " ".join((field.description or "").split())
        yield (
            key,
            "" if default is None else str(default),
            unit_of(name),
            allowed_of(field),
            meaning,
        )


def allowed_of(field: FieldInfo) -> str:
    """What a key may hold, in words: a range, choices, or an empty string."""
    inner = (
        part
        for kind in get_args(field.annotation)
        for part in get_args(kind)
        if isinstance(part, FieldInfo)
    )
    return (
        range_of(field)
        or _choices(field.annotation)
        or next((span for part in inner if (span := range_of(part))), "")
    )


def _choices(annotation: Any) -> str:
    present = [kind for kind in get_args(annotation) if kind is not type(None)]
    if get_origin(annotation) in (Union, UnionType) and len(present) == 1:  # something, or left out
        return _choices(present[0])
    if get_origin(annotation) is Literal:
        return ", ".join(map(str, get_args(annotation)))
    return "true, false" if annotation is bool else ""


def unit_of(key: str) -> str:
    """The unit that the suffix of `key` stands for, or an empty string."""
    return next(
        (
            unit
            for suffix, unit in sorted(UNITS.items(), key=lambda item: -len(item[0]))
            if key.endswith(suffix)
        ),
        "",
    )


def range_of(field: FieldInfo) -> str:
    """The allowed range of a numeric field in words, or an empty string."""
    bounds = {
        name: getattr(item, name)
        for item in field.metadata
        for name in ("ge", "gt", "le", "lt")
        if hasattr(item, name)
    }
    low = bounds.get("ge", bounds.get("gt"))
    high = bounds.get("le", bounds.get("lt"))
    if low is not None and high is not None:
        closed = "le" in bounds
        if "ge" in bounds:
            text = f"from {low:g} to {'' if closed else 'below '}{high:g}"
        else:
            text = f"above {low:g}, {'at most' if closed else 'below'} {high:g}"
    elif low is not None:
        text = f"of at least {low:g}" if "ge" in bounds else f"above {low:g}"
    elif high is not None:
        text = f"of at most {high:g}" if "le" in bounds else f"below {high:g}"
    else:
        text = ""
    return text


def _explain(error: ErrorDetails, model: type[BaseModel]) -> str:
    key = ".".join(str(part) for part in error["loc"]) or "the file"
    owner, field = _field_at(model, error["loc"])
    name = str(error["loc"][-1]) if error["loc"] else ""
    given = error["input"]
    if error["type"] == "extra_forbidden":
        known = (
            [info.alias or field_name for field_name, info in owner.model_fields.items()]
            if owner
            else []
        )
        guess = difflib.get_close_matches(name, known, 1)
        hint = f"did you mean `{guess[0]}`?" if guess else f"known here: {', '.join(known)}"
        return f"{key}: unknown key; {hint}"
    if error["type"] == "missing":
        return f"{key}: this key is required"
    unit = unit_of(
        next((str(part) for part in reversed(error["loc"]) if isinstance(part, str)), "")
    )
    suffix = f" ({unit})" if unit else ""
    span = range_of(field) if field else ""
    text = reprlib.repr(given)  # bounded, whatever anchors a file repeats
    shown = text if len(text) < 60 else f"this {type(given).__name__}"
    if error["type"] in {"model_type", "model_attributes_type"}:
        return f"{key}: {shown} is not a section; give `key: value` lines below it"
    if error["type"] in {"tuple_type", "list_type"}:
        return f"{key}: {shown} is not a list; give `- ` lines below it, or [..., ...]"
    if error["type"] in {"union_tag_not_found", "union_tag_invalid"}:
        context = {name: str(value).replace("'", "") for name, value in error["ctx"].items()}
        if "tag" not in context:
            return f"{key}.{context['discriminator']}: this key is required"
        return (
            f"{key}.{context['discriminator']}: no '{context['tag']}'; give one of "
            f"{context['expected_tags']}"
        )
    if error["type"] == "invalid_key":
        return f"{key}: a key must be text"
    if error["type"] in {
        "greater_than",
        "greater_than_equal",
        "less_than",
        "less_than_equal",
        "finite_number",
    }:
        return f"{key}: {shown} is out of range; give a number {span}{suffix}"
    if error["type"] in {
        "float_type",
        "float_parsing",
        "int_type",
        "int_parsing",
        "int_from_float",
    }:
        what = "a whole number" if error["type"].startswith("int") else "a number"
        return f"{key}: {shown} is not {what}; give {what} {span}".rstrip() + suffix
    said = f"{error['msg'].removeprefix('Value error, ')}{suffix}"
    if isinstance(given, dict):  # what is wrong is between keys of a section
        return f"{key}: {said}" if error["loc"] else said
    return f"{key}: {shown}: {said}"


def _field_at(
    model: type[BaseModel], location: tuple[int | str, ...]
) -> tuple[type[BaseModel] | None, FieldInfo | None]:
    """The model that owns the key at `location`, and the key's field where it has one."""
    owner: type[BaseModel] | None = model
    field: FieldInfo | None = None
    for part in location:
        if field is not None:
            owner = _model_in(field.annotation)
        if owner is None or not isinstance(part, str):
            continue
        named = {info.alias or name: info for name, info in owner.model_fields.items()}
        field = named.get(part)
        if field is None:
            return owner, None
    return owner, field


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """The first model inside an annotation such as ``Section``, ``Section | None`` or
    ``list[Section]``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(
        (found for inner in getattr(annotation, "__args__", ()) if (found := _model_in(inner))),
        None,
    )


def _location(location: tuple[int | str, ...], model: type[BaseModel]) -> tuple[int | str, ...]:
    """Where an error is in the file: pydantic adds the alternative that it tried when a field has
    several types."""
    _, field = _field_at(model, location[:-1])
    is_union = field is not None and get_origin(field.annotation) in (Union, UnionType)
    return (
        location[:-1]
        if is_union and field is not None and _model_in(field.annotation) is None
        else location
    )


def _explain_union(
    errors: list[ErrorDetails], location: tuple[int | str, ...], model: type[BaseModel]
) -> str:
    """A value that fits none of a field's types."""
    _, field = _field_at(model, location)
    bounded = [
        part
        for alternative in get_args(field.annotation if field else None)
        for part in get_args(alternative)
    ]
    span = next((range_of(part) for part in bounded if isinstance(part, FieldInfo)), "")
    words = [
        error["ctx"]["expected"]
        if error["type"] == "literal_error"
        else f"a number {span}".rstrip()
        for error in errors
    ]
    unit = unit_of(str(location[-1]))
    suffix = f" ({unit})" if unit else ""
    given = reprlib.repr(errors[0]["input"])
    return f"{'.'.join(map(str, location))}: {given} is neither {' nor '.join(words)}{suffix}"


def _yaml_problem(path: Path, text: str, error: yaml.YAMLError) -> str:
    """One line for a file that is not YAML."""
    mark = getattr(error, "problem_mark", None)
    line = mark.line + 1 if mark else text.count("\n", 0, getattr(error, "position", 0)) + 1
    parts = [getattr(error, name, None) for name in ("context", "problem", "reason")]
    problem = ": ".join(" ".join(str(part).split()) for part in parts if part)
    return f"{path}:{line}: not valid YAML: {problem or 'unreadable'}"


def _line_of(node: yaml.Node | None, location: tuple[int | str, ...]) -> int | None:
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

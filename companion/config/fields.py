"""What the keys of a section may hold: unit, range, choices, default and meaning.

The unit of a value is the suffix of its key; its range is declared with ``Field(ge=..., le=...)``.
"""

from collections.abc import Iterator
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

UNITS = {
    "_m": "m", "_mps": "m/s", "_mps2": "m/s2", "_radps": "rad/s", "_rad": "rad", "_deg": "degrees",
    "_pa": "Pa", "_hpa": "hPa", "_hpa_per_h": "hPa/h", "_k": "K", "_s": "s", "_us": "us",
    "_hz": "Hz", "_per_h": "1/h", "_bytes_per_s": "B/s", "_c": "degrees C", "_mb": "MB",
    "_m2": "m2", "_m2ps": "m2/s", "_m2ps3": "m2/s3", "_mps2_rthz": "m/s2/sqrt(Hz)",
    "_radps_rthz": "rad/s/sqrt(Hz)", "_rts": "1/sqrt(s)", "_m_rts": "m/sqrt(s)",
    "_mps2_rts": "m/s2/sqrt(s)", "_radps_rts": "rad/s/sqrt(s)", "_h": "h", "_pa_per_k": "Pa/K",
    "_pa_per_g": "Pa/g", "_m_per_h": "m/h", "_pa_per_s": "Pa/s", "_pa_rts": "Pa/sqrt(s)",
    "_mps2_per_k": "m/s2/K", "_radps_per_k": "rad/s/K", "hpa_per_100km": "hPa/100 km",
}  # fmt: skip


def keys(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, str, str, str, str]]:
    """Every key of a file of this model: (dotted key, default, unit, allowed, meaning)."""
    for name, field in model.model_fields.items():
        key = f"{prefix}{field.alias or name}"
        section = model_in(field.annotation)
        if section is not None:
            yield from keys(section, f"{key}.")
            continue
        default = field.get_default(call_default_factory=True)
        shown = "" if default is None else str(default)
        yield key, shown, unit_of(name), allowed_of(field), meaning_of(field)


def meaning_of(field: FieldInfo) -> str:
    """The description of a field on one line, with a capital letter and without a full stop."""
    text = " ".join((field.description or "").split()).removesuffix(".")
    return text[:1].upper() + text[1:]


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


def model_in(annotation: Any) -> type[BaseModel] | None:
    """The first model inside an annotation such as ``Section``, ``Section | None`` or
    ``list[Section]``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(
        (found for inner in getattr(annotation, "__args__", ()) if (found := model_in(inner))),
        None,
    )

"""One clear line for a mistake in a configuration: the key, what was given, what is allowed."""

import difflib
import reprlib
from types import UnionType
from typing import Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from companion.config.fields import model_in, range_of, unit_of

_STRUCTURE = {
    "missing": "this key is required",
    "invalid_key": "a key must be text",
}
_NOT_A_SECTION = "is not a section; give `key: value` lines below it"
_NOT_A_LIST = "is not a list; give `- ` lines below it, or [..., ...]"
_NOT_A = {
    "model_type": _NOT_A_SECTION,
    "model_attributes_type": _NOT_A_SECTION,
    "tuple_type": _NOT_A_LIST,
    "list_type": _NOT_A_LIST,
}
_OUT_OF_RANGE = frozenset(
    {"greater_than", "greater_than_equal", "less_than", "less_than_equal", "finite_number"}
)
_NUMBERS = {
    "float_type": "a number",
    "float_parsing": "a number",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
}


def explain(error: ErrorDetails, model: type[BaseModel]) -> str:
    """A value that its field does not take, a missing or an unknown key."""
    kind, location, given = error["type"], error["loc"], error["input"]
    key = ".".join(str(part) for part in location) or "the file"
    if kind in _STRUCTURE:
        return f"{key}: {_STRUCTURE[kind]}"
    if kind == "extra_forbidden":
        return f"{key}: unknown key; {_known_here(location, model)}"
    if kind in {"union_tag_not_found", "union_tag_invalid"}:
        return f"{key}.{_explain_tag(error)}"
    text = reprlib.repr(given)  # bounded, whatever anchors a file repeats
    shown = text if len(text) < 60 else f"this {type(given).__name__}"
    if kind in _NOT_A:
        return f"{key}: {shown} {_NOT_A[kind]}"
    _, field = _field_at(model, location)
    span = range_of(field) if field else ""
    suffix = _unit_suffix(location)
    if kind in _OUT_OF_RANGE:
        return f"{key}: {shown} is out of range; give a number {span}{suffix}"
    if kind in _NUMBERS:
        what = _NUMBERS[kind]
        return f"{key}: {shown} is not {what}; give {what} {span}".rstrip() + suffix
    said = f"{error['msg'].removeprefix('Value error, ')}{suffix}"
    if isinstance(given, dict):  # what is wrong is between keys of a section
        return f"{key}: {said}" if location else said
    return f"{key}: {shown}: {said}"


def _known_here(location: tuple[int | str, ...], model: type[BaseModel]) -> str:
    """The key that was probably meant, or all keys of the section."""
    owner, _ = _field_at(model, location)
    fields = owner.model_fields if owner else {}
    known = [info.alias or name for name, info in fields.items()]
    guess = difflib.get_close_matches(str(location[-1]), known, 1)
    return f"did you mean `{guess[0]}`?" if guess else f"known here: {', '.join(known)}"


def _explain_tag(error: ErrorDetails) -> str:
    """The key that says which kind a section is of is missing or wrong."""
    context = {name: str(value).replace("'", "") for name, value in error["ctx"].items()}
    if "tag" not in context:
        return f"{context['discriminator']}: this key is required"
    tag, allowed = context["tag"], context["expected_tags"]
    return f"{context['discriminator']}: no '{tag}'; give one of {allowed}"


def _unit_suffix(location: tuple[int | str, ...]) -> str:
    """The unit of the innermost named key, in brackets."""
    name = next((part for part in reversed(location) if isinstance(part, str)), "")
    unit = unit_of(name)
    return f" ({unit})" if unit else ""


def explain_union(
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
    key, given = ".".join(map(str, location)), reprlib.repr(errors[0]["input"])
    return f"{key}: {given} is neither {' nor '.join(words)}{_unit_suffix(location)}"


def place_of(location: tuple[int | str, ...], model: type[BaseModel]) -> tuple[int | str, ...]:
    """Where an error is in the file: pydantic adds the alternative that it tried when a field has
    several types."""
    _, field = _field_at(model, location[:-1])
    is_union = field is not None and get_origin(field.annotation) in (Union, UnionType)
    return (
        location[:-1]
        if is_union and field is not None and model_in(field.annotation) is None
        else location
    )


def _field_at(
    model: type[BaseModel], location: tuple[int | str, ...]
) -> tuple[type[BaseModel] | None, FieldInfo | None]:
    """The model that owns the key at `location`, and the key's field where it has one."""
    owner: type[BaseModel] | None = model
    field: FieldInfo | None = None
    for part in location:
        if field is not None:
            owner = model_in(field.annotation)
        if owner is None or not isinstance(part, str):
            continue
        named = {info.alias or name: info for name, info in owner.model_fields.items()}
        field = named.get(part)
        if field is None:
            return owner, None
    return owner, field

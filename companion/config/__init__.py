"""Typed YAML: every key optional, defaults in code beside what they tune, one clear line for every
mistake.

A section of a file is a `Settings` model that lives in the module it tunes; `load` reads a file
into one. The unit of a value is the suffix of its key, its range is declared with ``Field(ge=...,
le=...)``, and both appear in the error:

    companion.yaml:7: publish.altitude_hz: 500 is out of range; give a number from 0.1 to 100 (Hz)
"""

from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import ErrorDetails

from companion.config.explain import explain, explain_union, place_of
from companion.config.yaml_file import line_of, read
from companion.errors import ConfigError

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
    values, root = read(Path(path))
    return validate(values, model, source=str(path), root=root)


def validate(
    values: dict[str, Any], model: type[Model], source: str, root: yaml.Node | None = None
) -> Model:
    """Check `values` against `model`; `source` names their origin in the error.

    Raises `ConfigError`: one line for the first mistake in the file, with the number of others.
    """
    try:
        return model.model_validate(values)
    except ValidationError as failure:
        mistakes: dict[tuple[int | str, ...], list[ErrorDetails]] = {}
        for error in failure.errors():
            mistakes.setdefault(place_of(error["loc"], model), []).append(error)
        location = min(mistakes, key=lambda location: line_of(root, location) or 0)
        line, errors = line_of(root, location), mistakes[location]
        place = f"{source}:{line}" if line else source
        said = (
            explain(errors[0], model)
            if len(errors) == 1
            else explain_union(errors, location, model)
        )
        more = f" (and {len(mistakes) - 1} more)" if len(mistakes) > 1 else ""
        raise ConfigError(f"{place}: {said}{more}") from None


def dump(model: BaseModel) -> str:
    """The resolved configuration as YAML."""
    return yaml.safe_dump(
        model.model_dump(mode="json", by_alias=True), sort_keys=False, allow_unicode=True
    )

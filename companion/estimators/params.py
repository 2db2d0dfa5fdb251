"""Parameters of an estimator's steps, derived from its pydantic settings: each name stands once.

`EstimatorSettings` is the base of a section ``estimators.NAME``. Its fields that are numbers become
fields of the parameter record of the same name; what a step needs in another form (letters of a
paper, a choice as a number) is `derived` from them.
"""

from collections.abc import Mapping
from types import UnionType
from typing import Any, ClassVar, Self, Union, get_args, get_origin

import numpy as np
from pydantic import ModelWrapValidatorHandler, model_validator

from companion.config import Settings
from companion.samples import Rows, rows


class EstimatorSettings(Settings):
    """Settings of an estimator, with their form for compiled steps.

    Three layers: keys that are given count more than those of the ``preset``, and these more than
    the defaults. ``model_fields_set`` holds the keys that were given, so that ``exclude_unset``
    dumps the first layer alone.
    """

    PRESETS: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    """Keys of each value of ``preset`` that differ from the defaults."""

    @model_validator(mode="wrap")
    @classmethod
    def _layers(cls, values: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        if not isinstance(values, dict):
            return handler(values)
        preset = cls.PRESETS.get(str(values.get("preset")), {})
        model = handler({**preset, **values})
        model.__pydantic_fields_set__.difference_update(preset.keys() - values.keys())
        return model

    def derived(self) -> Mapping[str, Any]:
        """Parameters beyond the fields, or in another form: name -> number or nested tuple of
        numbers."""
        return {}

    def params(self) -> Rows:
        """The parameter record, shape (1,), of dtype `params_dtype`."""
        derived = dict(self.derived())
        row = rows(params_dtype(type(self), derived))
        for name in row.dtype.names or ():
            value = derived[name] if name in derived else getattr(self, name)
            row[name] = np.nan if value is None else value
        return row


def params_dtype(model: type[Settings], derived: Mapping[str, Any] | None = None) -> np.dtype[Any]:
    """The parameter dtype of a settings model.

    A field of type bool or int becomes ``i8``, float ``f8`` (also where it may be None, which is
    NaN), a tuple of n numbers an array of shape (n,). Fields of other types (choices, texts) are
    left out: `derived` gives them as numbers. A name in `derived` counts more than a field.
    """
    fields: list[tuple[Any, ...]] = []
    for name, field in model.model_fields.items():
        form = _form(field.annotation)
        if form and name not in (derived or {}):
            fields.append((name, *form))
    for name, value in (derived or {}).items():
        array = np.asarray(value)
        kind = "i8" if array.dtype.kind in "bi" else "f8"
        fields.append((name, kind, array.shape) if array.shape else (name, kind))
    return np.dtype(fields, align=True)


def _form(annotation: Any) -> tuple[Any, ...]:
    """Format and shape of a field, () when it is no number."""
    if hasattr(annotation, "__metadata__"):  # Annotated
        return _form(annotation.__origin__)
    origin, inner = get_origin(annotation), get_args(annotation)
    if annotation in (bool, int):
        return ("i8",)
    if annotation is float:
        return ("f8",)
    if origin in (Union, UnionType):
        forms = {_form(each) for each in inner if each is not type(None)}
        return forms.pop() if forms == {("f8",)} else ()
    if origin is tuple and inner and Ellipsis not in inner:
        forms = {_form(each) for each in inner}
        return (*forms.pop(), (len(inner),)) if len(forms) == 1 and forms != {()} else ()
    return ()

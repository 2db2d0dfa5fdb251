"""Every key of a scenario file as Markdown, made from the models that read it:
`config/scenarios/README.md`."""

from collections.abc import Iterator, Mapping
from typing import Any, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from companion.config.fields import allowed_of, meaning_of, unit_of
from sim.scenario import Scenario
from sim.sensors import SensorConfig

HEAD = """# Keys of a scenario

A scenario is a YAML file. What it leaves out has the default here; an unknown key, a wrong type or
a value out of range is refused with one line that names file, line and key. `key[]` is a list.
[docs/scenarios.md](../../docs/scenarios.md) shows how to write and fly one. Written by `make
config-page`, not by hand."""

Row = tuple[str, str, str, str, str]


def page() -> str:
    """The whole page."""
    sections = [HEAD, _table(_rows(Scenario, ""))]
    for title, key in (("Legs of `profile[]`", "profile"), ("Faults of `faults[]`", "faults")):
        sections.append(f"## {title}")
        alternatives = models_in(Scenario.model_fields[key].annotation)
        common = _common(alternatives) if key == "faults" else {}
        if common:
            sections.append(
                "All of them have these:\n\n"
                + _table(_row(name, field) for name, field in common.items())
            )
        for model in alternatives:
            own = {name: field for name, field in model.model_fields.items() if name not in common}
            tag = next(iter(kind for name in own if (kind := _tag(name, own[name]))))
            sections.append(f"### `{tag}`\n\n{_said(model)}")
            rows = [_row(name, field) for name, field in own.items() if not _tag(name, field)]
            if rows:
                sections.append(_table(rows))
    sections.append("## Presets of the sensors\n\n" + "\n\n".join(_presets()))
    return "\n\n".join(sections) + "\n"


def models_in(annotation: Any) -> list[type[BaseModel]]:
    """All models inside an annotation: of a union of alternatives, of a list of them."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for inner in get_args(annotation) for model in models_in(inner)]


def _rows(model: type[BaseModel], prefix: str) -> Iterator[Row]:
    """The rows of a model and of the models within it; alternatives have sections of their own."""
    for name, field in model.model_fields.items():
        models, key = models_in(field.annotation), f"{prefix}{name}"
        key += "[]" if get_origin(field.annotation) is tuple else ""
        if len(models) == 1:
            if prefix or key.endswith("[]") or not field.is_required():
                yield (
                    key,
                    _default(field),
                    "",
                    "",
                    _said(models[0]) + (f" {field.description}" if field.description else ""),
                )
            yield from _rows(models[0], f"{key}.")
        elif models:
            yield key, _default(field), "", "see below", meaning_of(field)
        else:
            yield _row(key, field)


def _row(key: str, field: FieldInfo) -> Row:
    return key, _default(field), unit_of(key), allowed_of(field), meaning_of(field)


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "**required**"
    default = field.get_default(call_default_factory=True)
    return "" if default is None or isinstance(default, BaseModel | tuple | dict) else str(default)


def _common(models: list[type[BaseModel]]) -> Mapping[str, FieldInfo]:
    """The fields that all alternatives share, as most of them have them."""
    names = set.intersection(*(set(model.model_fields) for model in models))
    first = models[0].model_fields
    alike = (name for name in first if name in names and not _tag(name, first[name]))
    return {
        name: first[name]
        for name in alike
        if all(_row(name, m.model_fields[name]) == _row(name, first[name]) for m in models)
    }


def _tag(name: str, field: FieldInfo) -> str:
    """What says which alternative it is: its name there."""
    return str(get_args(field.annotation)[0]) if name in ("leg", "fault") else ""


def _said(model: type[BaseModel]) -> str:
    """The first paragraph of a model's docstring."""
    return " ".join((model.__doc__ or "").split("\n\n")[0].split())


def _presets() -> Iterator[str]:
    for name, field in _sensors().items():
        if field.PRESETS:
            lines = [
                f"`{preset}`: "
                + ", ".join(
                    f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"
                    for key, value in values.items()
                )
                for preset, values in field.PRESETS.items()
            ]
            yield f"`sensors.{name}.preset`\n\n" + "\n".join(f"- {line}" for line in lines)


def _sensors() -> dict[str, type[SensorConfig]]:
    (model,) = models_in(Scenario.model_fields["sensors"].annotation)
    found = {name: models_in(field.annotation)[0] for name, field in model.model_fields.items()}
    return {name: kind for name, kind in found.items() if issubclass(kind, SensorConfig)}


def _table(rows: Any) -> str:
    lines = ["| key | default | unit | allowed | meaning |", "|---|---|---|---|---|"]
    lines += [f"| `{key}` | {' | '.join(cells)} |" for key, *cells in rows]
    return "\n".join(lines)

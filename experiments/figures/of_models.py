"""Blocks of keys and arrays, from the models of the files that have them.

A key's meaning is the title of its field, else its description, the remedy in messages.
"""

from collections.abc import Iterable, Iterator
from typing import Any, get_args

import numpy as np
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from common.documents import Excerpt
from data.captures.description import Description, Labels, OutlineSource, Weighed
from data.dataset.shards import fields
from data.readings import QUANTITIES
from data.readings.known import Reported
from drapenet.measured.strips.description import Scale, StripEntry, StripsDescription, View
from drapenet.measured.tension.description import StretchedStrip, TensionDescription
from drapenet.result.document import EstimateDocument
from experiments.figures.reports import Reports

Model = type[BaseModel]
VERTICES, MOVED = -1, -2  # lengths that differ between shards


def capture_keys(reports: Reports) -> str:
    """Keys of ``capture.yaml``."""
    return items([*keys(Description, without=(Labels,)), *keys(OutlineSource, "outline."),
                  *keys(Labels)])


def strips_keys(reports: Reports) -> str:
    """Keys of ``strips.yaml`` beside those of a capture."""
    return items([*keys(StripsDescription, without=(Weighed, Labels)), *keys(Scale, "scale."),
                  *keys(StripEntry, "strips.", without=(View,))])


def tension_keys(reports: Reports) -> str:
    """Keys of ``tension.yaml`` beside those of a capture."""
    return items([*keys(TensionDescription, without=(Weighed, Labels)),
                  *keys(StretchedStrip, "tension.")])


def known_keys(reports: Reports) -> str:
    """Keys of ``known``: evidence with its assumed error, and others."""
    evidence = [(each.name, "{:g} to {:g}".format(*each.limits),
                 f"{each.in_words}, ± {100 * each.error:g} %"
                 + ", along warp, bias, weft" * (each.directions > 1))
                for each in QUANTITIES.values()]
    return items([*evidence, *keys(Reported)])


def estimate_keys(reports: Reports) -> str:
    """Keys of ``estimate.json``."""
    return items((key, "", text) for key, text in documented(EstimateDocument, set()))


def shard_arrays(reports: Reports) -> str:
    """Arrays of a shard."""
    rows = []
    for name, field in fields(VERTICES, MOVED).items():
        kind = np.dtype(field.dtype)
        sizes = [{VERTICES: "V", MOVED: "M"}.get(size, str(size)) for size in field.shape]
        value = "text" if kind.kind == "S" else "×".join([kind.name, *sizes])
        rows.append((name, ", ".join(filter(None, [value, field.unit])), field.meaning))
    return items(rows)


def items(rows: Iterable[tuple[str, str, str]]) -> str:
    """List of keys with their values and meanings."""
    return "\n".join(f"- `{key}`{f' ({value})' * bool(value)}: {text}" for key, value, text in rows)


def keys(
    model: Model, prefix: str = "", without: tuple[Model, ...] = ()
) -> Iterator[tuple[str, str, str]]:
    """Key, values and meaning of each field of a model that has a meaning."""
    properties = model.model_json_schema()["properties"]
    left_out = {name for other in without for name in other.model_fields}
    for name, field in model.model_fields.items():
        if name not in left_out and meaning(field):
            key = field.alias or name
            yield f"{prefix}{key}", values(properties[key]), meaning(field)


def meaning(field: FieldInfo) -> str:
    """What a field means; empty if its model does not say."""
    return field.title or field.description or ""


def values(schema: dict[str, Any]) -> str:
    """All values that a field may have, the default first, or default and range of a number."""
    kind = next(kind for kind in schema.get("anyOf", [schema]) if kind.get("type") != "null")
    default = schema.get("default")
    if "enum" in kind or kind.get("type") == "boolean":
        every = [str(value).lower() for value in kind.get("enum", (True, False))]
        return ", ".join(sorted(every, key=[str(default).lower(), *every].index))
    low, high = (kind.get(end, kind.get(f"exclusive{end.capitalize()}"))
                 for end in ("minimum", "maximum"))
    found = [f"{default:g}"] if isinstance(default, float) else []
    return "; ".join([*found, *([f"{low:g} to {high:g}"] if high else [])])


def documented(model: Model, seen: set[Model], prefix: str = ""
               ) -> Iterator[tuple[str, str]]:
    """Key and meaning of each field that has a title, and of the models in it, each once."""
    for name, field in model.model_fields.items():
        key = f"{prefix}{field.alias or name}"
        if meaning(field):
            yield key, meaning(field)
        between = ".DIRECTION." if "dict[" in str(field.annotation) else "."
        for inner in models_in(field.annotation):
            if inner not in seen:
                seen.add(inner)
                yield from documented(inner, seen, key + between)


def models_in(annotation: Any) -> list[Model]:
    """The models in the type of a field, but for those of files that users write."""
    if isinstance(annotation, type) and issubclass(annotation, Excerpt):
        return [annotation]
    return [model for part in get_args(annotation) for model in models_in(part)]

"""Streams, units and conversions in words, for trees and reasons."""

from __future__ import annotations

from collections.abc import Collection

from ..languages.ssl.annotation import Content
from ..ontology.units import format_unit
from ..ontology.vocabulary import THING
from ..rdf.namespaces import shorten
from .fit import Roles
from .plan import Port, local_name
from .space import TransformationDescription


def whose(roles: Roles) -> str:
    """``every dyknow:UAV``, ``dyknow:uav1``; several of an n-ary feature."""
    names = (
        f"every {shorten(role.sort or THING)}" if role.object is None else shorten(role.object)
        for role in roles
    )
    return " and ".join(names)


def conversion_words(port: Port) -> str:
    """``m.s-1 → km.h-1 × 3.6``; empty where values stay as they are."""
    change = port.conversion
    if change.is_identity:
        return ""
    text = f"{format_unit(port.source)} → {format_unit(port.target)}"
    if change.factor != 1.0:
        text += f" × {change.factor:.6g}"
    if change.offset != 0.0:
        text += f" {'+' if change.offset > 0 else '−'} {abs(change.offset):.6g}"
    return text


def stream_words(
    stream: str,
    contents: tuple[Content, ...],
    fields: Collection[str],
    ports: Collection[Port] = (),
) -> str:
    """``stream positions : latitude [deg], longitude [deg] for every UAV = id``.

    Only the contents in ``fields`` (all if none). A port's conversion stands with its field.
    """
    used = [content for content in contents if content.field in fields] or list(contents)
    changes = {port.source_field: conversion_words(port) for port in ports}
    features = []
    for content in used:
        unit = changes.get(content.field) or (format_unit(content.unit) if content.unit else "")
        features.append(local_name(content.feature) + (f" [{unit}]" if unit else ""))
    return f"stream {stream} : {', '.join(features)}{_for_words(used[0].roles)}"


def _for_words(roles: Roles) -> str:
    pairs = []
    for role in roles:
        name = local_name(role.object or role.sort or THING)
        name = name if role.object is not None else f"every {name}"
        pairs.append(name if role.id_field is None else f"{name} = {role.id_field}")
    return f" for {', '.join(pairs)}" if pairs else ""


def unit_words(unit: TransformationDescription) -> str:
    """``coordinatesToSpeed : latitude, longitude ⇒ speed``."""
    inputs = ", ".join(local_name(port.feature) for port in unit.inputs) or "∅"
    return f"{unit.name} : {inputs} ⇒ {local_name(unit.output.feature)}"

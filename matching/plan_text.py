"""Streams, transformations and conversions as text, for trees and reasons."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from ..languages.ssl.annotation import Content, PortAnnotation
from ..ontology.units import format_unit
from ..ontology.vocabulary import SELF, THING
from ..rdf.namespaces import local_name
from .plan import Port
from .space import ITSELF, TransformationDescription
from .subject import Roles


def conversion_text(port: Port) -> str:
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


def stream_text(
    stream: str,
    contents: tuple[Content, ...],
    fields: Collection[str],
    ports: Collection[Port] = (),
    maker: str = "",
) -> str:
    """``stream positions : latitude [deg], longitude [deg] for every UAV = id``.

    Only the contents in ``fields`` (all if none). A port's conversion stands with its field.
    ``maker`` is the transformation whose unit makes the stream.
    """
    used = [content for content in contents if content.field in fields] or list(contents)
    changes = {port.source_field: conversion_text(port) for port in ports}
    features = []
    for content in used:
        unit = changes.get(content.field) or (format_unit(content.unit) if content.unit else "")
        features.append(local_name(content.feature) + (f" [{unit}]" if unit else ""))
    made = f" by {maker}" if maker else ""
    return f"stream {stream}{made} : {', '.join(features)}{_for_text(used[0].roles)}"


def _for_text(roles: Roles) -> str:
    pairs = []
    for role in roles:
        name = local_name(role.object or role.sort or THING)
        name = name if role.object is not None else f"every {name}"
        pairs.append(name if role.id_field is None else f"{name} = {role.id_field}")
    return f" for {', '.join(pairs)}" if pairs else ""


def transformation_text(unit: TransformationDescription) -> str:
    """``coordinatesToSpeed : latitude, longitude ⇒ speed``, as [Introspection15 §4.3] writes it;
    sorts where they were written: ``humanDetector : RGB[RMAX], IR[RMAX] ⇒ PixelLocation[Human]``.
    """
    inputs = ", ".join(map(port_text, unit.inputs)) or "∅"
    output = port_text(
        replace(unit.output, arguments=unit.output.arguments or (ITSELF if not unit.inputs else ()))
    )
    return f"{unit.name} : {inputs} ⇒ {output}"


def port_text(port: PortAnnotation) -> str:
    """``RGB[RMAX]``; ``latitude`` where the port has no arguments."""
    names = ", ".join(
        "self" if argument.object == SELF else local_name(argument.object or argument.sort or THING)
        for argument in port.arguments
    )
    return local_name(port.feature) + (f"[{names}]" if names else "")

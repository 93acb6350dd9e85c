"""Looks for terms of the ontology in checked values: annotations, queries, wants, declarations."""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import fields, is_dataclass

from pyoxigraph import NamedNode


def names_any(value: object, terms: Set[str]) -> bool:
    """Return whether a value contains one of ``terms`` (IRIs): as a text or a node, in dataclasses,
    tuples and mappings at any depth. Cost: linear in the value."""
    waiting = [value]
    while waiting:
        one = waiting.pop()
        match one:
            case str():
                if one in terms:
                    return True
            case NamedNode():
                if one.value in terms:
                    return True
            case Mapping():
                waiting += [*one.keys(), *one.values()]
            case tuple() | list() | frozenset():
                waiting += one
            case _ if is_dataclass(one):
                waiting += [getattr(one, field.name) for field in fields(one)]
    return False

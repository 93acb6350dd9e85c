"""Lists of fields in query parameters: ``fields=id,spd``, or ``fields=id&fields=spd``."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from ...languages.hints import did_you_mean
from .problems import Problem

_SHOWN = 20
"""Names that a hint lists."""


def chosen_fields(
    items: Sequence[str] | None, known: Collection[str], what: str
) -> tuple[str, ...] | None:
    """The fields that the parameter ``fields`` names, each once and in order; None without one.

    A name with a comma is an item of its own. Raises a 400 `Problem` with the nearest names for one
    that ``what`` does not have, whose fields are ``known``.
    """
    if items is None:
        return None
    names = [name for item in items for name in ([item] if item in known else item.split(","))]
    for name in names:
        if name not in known:
            there = [*known][:_SHOWN]
            raise Problem(
                400,
                "unknown field",
                f"fields: {what} has no field {name!r}",
                hint=did_you_mean(name, known)
                or f"there are: {', '.join(there)}{', …' if len(known) > _SHOWN else ''}",
                field=name,
            )
    return tuple(dict.fromkeys(names))

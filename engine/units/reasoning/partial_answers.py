"""The partial matches of a pattern as answers: events by name, values as matches have them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ....converters.objects import object_in_text
from ....languages.mtl.checked import Kind
from ....rdf.namespaces import DYKNOW
from ....reasoning.patterns.plans.plan import PatternPlan
from ....reasoning.patterns.plans.query import Keys, Part, PatternQuery, object_key
from ....reasoning.patterns.recognition.explanation import (
    PartialMatch,
    PartialMatches,
    PendingEvent,
)
from ....reasoning.patterns.recognition.partial import Partial
from ....reasoning.patterns.recognition.recognition import Recognition
from .match_samples import MatchWriter


def partial_answers(
    query: PatternQuery,
    recognition: Recognition,
    keys: Keys,
    writer: MatchWriter,
    objects: Sequence[str],
    limit: int,
    part: int = 0,
) -> PartialMatches:
    """Return the partial matches of ``query`` with all these ``objects`` (as the matches name them,
    or IRIs), at most ``limit``; where ``recognition`` has parts, those of ``part``.

    The objects that the query itself names are in all of them. Raises `PlanError` for a pattern
    whose partial matches are not known.
    """
    own = {argument.object for source in query.sources for argument in source.arguments}
    iris = [object_in_text(each, DYKNOW) for each in objects]
    wanted = [keys.find(object_key(iri)) for iri in iris if iri not in own]
    now = recognition.watermark_of(part)
    found, more = recognition.partials(limit, wanted, part)
    if None in wanted:
        return PartialMatches(now, (), more=False)
    columns = _columns(query)
    told = tuple(_told(partial, plan, columns, writer) for plan, partial in found)
    return PartialMatches(now, told, more)


def _told(
    partial: Partial,
    plan: PatternPlan,
    columns: Mapping[str, tuple[str, Kind]],
    writer: MatchWriter,
) -> PartialMatch:
    names = [element.name for element in plan.elements]
    events = tuple(
        (
            names[element],
            row.end,
            {
                columns[column][0]: writer.value(columns[column][1], value)
                for column, value in row.values.items()
                if value is not None and column in columns
            },
        )
        for element, row in partial.rows
    )
    pending = tuple(
        PendingEvent(names[each.element], each.earliest, each.latest) for each in partial.pending
    )
    return PartialMatch(events, pending)


def _columns(query: PatternQuery) -> dict[str, tuple[str, Kind]]:
    """The name and the kind of each column of the plans that has values."""
    found: dict[str, tuple[str, Kind]] = {}
    for source in query.sources:
        for each in source.columns:
            if not each.as_key:
                is_value = each.part in (Part.VALUE, Part.BEFORE)
                kind = Kind.OBJECT if each.part is Part.OBJECT else each.kind or Kind.NUMBER
                found[each.column] = (str(each.part) if is_value else each.column, kind)
    return found

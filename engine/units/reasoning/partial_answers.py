"""The partial matches of a pattern as answers: events by name, values as matches have them."""

from __future__ import annotations

from collections.abc import Sequence

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
    kinds = _kinds(query)
    told = tuple(_told(partial, plan, kinds, writer) for plan, partial in found)
    return PartialMatches(now, told, more)


def _told(
    partial: Partial, plan: PatternPlan, kinds: dict[str, Kind], writer: MatchWriter
) -> PartialMatch:
    names = [element.name for element in plan.elements]
    events = tuple(
        (
            names[element],
            row.end,
            {
                column: writer.value(kinds[column], value)
                for column, value in row.values.items()
                if value is not None and column in kinds
            },
        )
        for element, row in partial.rows
    )
    pending = tuple(
        PendingEvent(names[each.element], each.earliest, each.latest) for each in partial.pending
    )
    return PartialMatch(events, pending)


def _kinds(query: PatternQuery) -> dict[str, Kind]:
    """The kind of each column of the plans that has values."""
    columns = [c for source in query.sources for c in source.columns if not c.as_key]
    found = {
        each.column: Kind.OBJECT if each.part is Part.OBJECT else each.kind for each in columns
    }
    return {column: kind or Kind.NUMBER for column, kind in found.items()}

"""Finding the streams of a query that names none: from the features it needs, by semantic matching
([Events14 §IV.A, §V.B]). For requests of events and for registered queries alike.
"""

from __future__ import annotations

from collections.abc import Iterable

from ...languages.csparql.ast import ContinuousQuery
from ...matching.match import Match, UnknownStrategy
from ...matching.plan import Supply, UseStream, nodes_of_supply
from ...matching.space import StreamSpace
from ...ontology.ontology import Ontology
from ...templates.needs import Needs
from ..model.beginning import Beginning
from ..model.errors import BadArguments, NoPlan
from .plan_execution import Plans


def check_graphs(ontology: Ontology, query: ContinuousQuery) -> None:
    """The graphs that a query names are loaded ontologies; raises `NoPlan`."""
    named = (("FROM", query.static), ("FROM NAMED", query.static_named))
    for clause, graph in ((clause, graph) for clause, graphs in named for graph in graphs):
        if not ontology.has_ontology(graph):
            known = ", ".join(f"<{iri}>" for iri in ontology.ontologies())
            raise NoPlan(
                f"{clause} <{graph}> names no loaded ontology",
                (graph,),
                "static graphs are named, never fetched: load it (POST /ontologies), or leave "
                f"{clause} out; there are {known}",
            )


def find_streams(
    plans: Plans, wanted: Needs, strategy: str, since: Beginning, asked: str
) -> tuple[Match, ...]:
    """A match for each feature that ``asked`` needs; raises `NoPlan` and `BadArguments`."""
    without = plans.unusable(since)
    try:
        matches = plans.match(wanted.wants, strategy, without, explained=True)
    except UnknownStrategy as error:
        raise BadArguments(str(error)) from error
    missing = tuple(
        f"{match.want}: {text}"
        for match in matches
        if match.supply is None
        for text in match.missing or ("nothing gives it",)
    )
    if missing or not matches:
        raise NoPlan(
            f"no stream and no transformation answers {asked}: "
            + ("; ".join(missing) or "the query needs no feature of a stream"),
            missing,
            "annotate a stream that contains the feature, or one it can be computed from; "
            "POST /match shows what was tried",
        )
    return matches


def supplies_of(matches: Iterable[Match]) -> list[Supply]:
    """What the matches found."""
    return [match.supply for match in matches if match.supply is not None]


def mean_the_same(matches: Iterable[Match], space: StreamSpace) -> bool:
    """Whether the streams that were found mean what they meant then."""
    streams = space.streams
    return all(
        node.stream in streams and streams[node.stream].contents == node.contents
        for match in matches
        if match.supply is not None
        for node in nodes_of_supply(match.supply)
        if isinstance(node, UseStream)
    )

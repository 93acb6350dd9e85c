"""Finds streams for a query that names none, by semantic matching of the features that it needs
([Events14 §IV.A, §V.B]). Requests of events and registered queries use it.
"""

from __future__ import annotations

from collections.abc import Iterable

from ...matching.match import Match, UnknownStrategy
from ...matching.plan import Supply, UseStream, nodes_of_supply
from ...matching.space import StreamSpace
from ...templates.needs import Needs
from ..model.beginning import Beginning
from ..model.errors import BadArguments, NoPlan
from .plan_execution import Plans

REMEDY = "annotate a stream that contains the feature, or one from which it can be computed"
"""What to do about a missing feature."""


def find_streams(
    plans: Plans, wanted: Needs, strategy: str, since: Beginning, description: str
) -> tuple[Match, ...]:
    """Match each feature that ``description`` needs. Raises `NoPlan`, `BadArguments`."""
    try:
        matches = plans.match_from(wanted.wants, strategy, since, explained=True)
    except UnknownStrategy as error:
        raise BadArguments(str(error)) from error
    missing = tuple(reason for match in matches for reason in match.lacks)
    if missing or not matches:
        raise NoPlan(
            f"no stream and no transformation answers {description}"
            + ("" if missing else ": the query needs no feature of a stream"),
            missing,
            f"{REMEDY}; dyknow match (POST /match) shows the alternatives tried",
        )
    return matches


def supplies_of(matches: Iterable[Match]) -> list[Supply]:
    """Return the supplies of the matches that succeeded."""
    return [match.supply for match in matches if match.supply is not None]


def mean_the_same(matches: Iterable[Match], space: StreamSpace) -> bool:
    """Whether the streams of the matches still exist with the same annotations."""
    streams = space.streams
    return all(
        node.stream in streams and streams[node.stream].contents == node.contents
        for match in matches
        if match.supply is not None
        for node in nodes_of_supply(match.supply)
        if isinstance(node, UseStream)
    )

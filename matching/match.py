"""Semantic matching: a wanted feature in, the streams and units that give it out.

[Introspection15 §4.3]. The strategy *fast* takes the first valid plan that depth-first search
finds (the order is `search`'s). The engine calls `match_all` with what a query needs.

How much of what was wanted: one stream (or unit) that holds every wanted object is a complete
supply. Where there is none, each stream that holds some of them is a source, and together they
are a partial supply; of two where one covers the other's objects only the wider is taken, so that
no sample counts twice.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from ..ontology.vocabulary import Vocabulary
from .explain import alternatives, missing
from .fit import Fit, Roles
from .plan import Supply, SupplySource
from .render import render
from .search import Found, Search
from .space import StreamSpace
from .tree import Alternative, Match, Outcome
from .want import Want

__all__ = [
    "STRATEGIES",
    "Alternative",
    "Match",
    "Outcome",
    "UnknownStrategy",
    "match",
    "match_all",
    "render",
]

STRATEGIES = ("fast",)


class UnknownStrategy(ValueError):
    """A strategy that there is not; ``known`` are those there are."""

    def __init__(self, strategy: str) -> None:
        super().__init__(f"there is no strategy {strategy!r}; there is: {', '.join(STRATEGIES)}")
        self.strategy = strategy
        self.known = STRATEGIES


def match(want: Want, space: StreamSpace, vocabulary: Vocabulary, strategy: str = "fast") -> Match:
    """The first supply that depth-first search finds, or what is missing.

    Raises `UnknownStrategy`. Law: the same arguments give the equal match.
    """
    _check(strategy)
    return _match(want, space, vocabulary, strategy, {})


def match_all(
    wants: Sequence[Want], space: StreamSpace, vocabulary: Vocabulary, strategy: str = "fast"
) -> tuple[Match, ...]:
    """A match a want, in order; a stream that serves several of them goes before others.

    Raises `UnknownStrategy`.
    """
    _check(strategy)
    favoured = _favoured(wants, space, vocabulary)
    return tuple(
        _match(want, space, vocabulary, strategy, favoured[want.wanted_sort, want.object])
        for want in wants
    )


def _check(strategy: str) -> None:
    if strategy not in STRATEGIES:
        raise UnknownStrategy(strategy)


def _favoured(
    wants: Sequence[Want], space: StreamSpace, vocabulary: Vocabulary
) -> Mapping[tuple[str, str | None], Mapping[int, int]]:
    """For each sort and object wanted: how many of its features each stream holds."""
    groups: dict[tuple[str, str | None], list[Want]] = {}
    for want in dict.fromkeys(wants):
        groups.setdefault((want.wanted_sort, want.object), []).append(want)
    favoured: dict[tuple[str, str | None], Mapping[int, int]] = {}
    for key, group in groups.items():
        counts: Counter[int] = Counter()
        # A single want has nothing to share.
        for want in group if len(group) > 1 else ():
            search = Search(want, space, vocabulary)
            counts.update(
                {
                    offer.position
                    for offer in search.all_offers(search.top)
                    if search.sorts.fit(offer.contents[0].roles)[0] is Fit.WHOLLY
                }
            )
        favoured[key] = counts
    return favoured


def _match(
    want: Want,
    space: StreamSpace,
    vocabulary: Vocabulary,
    strategy: str,
    favoured: Mapping[int, int],
) -> Match:
    search = Search(want, space, vocabulary, favoured)
    supply = _supply(search)
    tree = alternatives(search, supply)
    return Match(want, strategy, supply, tree, missing(search, tree) if supply is None else ())


def _supply(search: Search) -> Supply | None:
    fits = {roles: search.sorts.fit(roles)[0] for roles in search.roles()}
    wholly = frozenset(roles for roles, fit in fits.items() if fit is Fit.WHOLLY)
    found = search.find(search.top, wholly) if wholly else None
    if found is not None:
        return Supply(search.want, (_source(found),), complete=True)
    partly = {}
    for roles, fit in fits.items():
        if fit is Fit.PARTLY and search.possible(search.top, roles):
            found = search.find(search.top, frozenset((roles,)))
            if found is not None:
                partly[roles] = found
    sources = tuple(_source(partly[roles]) for roles in _widest(search, tuple(partly)))
    return Supply(search.want, sources, complete=False) if sources else None


def _widest(search: Search, found: Sequence[Roles]) -> Sequence[Roles]:
    """Those whose objects no other covers; of equals the first."""
    covers = search.sorts.covers
    place = {roles: i for i, roles in enumerate(found)}
    # Only a sort can cover more than itself, and sorts are few where objects may be many.
    wide = [roles for roles in found if roles[0].object is None]
    first: dict[tuple[str | None, ...], Roles] = {}
    for roles in found:
        first.setdefault(tuple(role.object for role in roles), roles)

    def is_covered(roles: Roles) -> bool:
        same = first[tuple(role.object for role in roles)]
        return any(
            covers(other, roles) and (place[other] < place[roles] or not covers(roles, other))
            for other in (*wide, same)
            if other != roles
        )

    return [roles for roles in found if not is_covered(roles)]


def _source(found: Found) -> SupplySource:
    return SupplySource(found.node, found.ports[0], found.roles)

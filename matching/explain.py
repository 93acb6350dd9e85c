"""Why this plan, and why not another: the transformation tree in words ([Introspection15 §4.3])."""

from __future__ import annotations

from collections.abc import Iterator

from ..languages.ssl.annotation import StreamAnnotation
from ..rdf.namespaces import shorten
from .fit import Fit, Roles
from .plan import Compute, Supply, UseStream, nodes_of
from .search import MAX_DEPTH, Ask, Found, Input, Search, why_not_convertible
from .space import TransformationDescription
from .tree import Alternative, Outcome
from .words import stream_words, unit_words, whose

LISTED = 20
"""Alternatives listed of one kind; of more, only the number is told."""
EXPLAINED_DEPTH = 12
"""Features on a path beyond which a failure is not taken apart further."""


def alternatives(search: Search, supply: Supply | None) -> tuple[Alternative, ...]:
    """All ways to the wanted feature: streams, then transformations, in the order of trying.

    With a complete supply what comes after the choice was not tried: that is what makes *fast*
    fast. Streams are judged all the same, since a look suffices.
    """
    explainer = _Explainer(search)
    streams = tuple(explainer.streams(search.top[0], supply))
    units = tuple(explainer.units(search.top, frozenset(), supply))
    return streams + units


def missing(search: Search, tree: tuple[Alternative, ...]) -> tuple[str, ...]:
    """What would have to be there: the leaves of a tree without a plan, each once."""
    if not tree:
        return (_Explainer(search).nothing_gives(search.want.feature),)
    leaves = dict.fromkeys(_leaves(tree))
    return tuple(leaves)[:LISTED]


def _leaves(tree: tuple[Alternative, ...]) -> Iterator[str]:
    for alternative in tree:
        if alternative.parts:
            yield from _leaves(alternative.parts)
        elif alternative.reason:
            name = alternative.text.partition(" : ")[0]
            own = alternative.reason.startswith("no stream and no transformation")
            yield alternative.reason if own else f"{name}: {alternative.reason}"


class _Explainer:
    """Words for one search. A transformation that fails is explained where it is met first."""

    def __init__(self, search: Search) -> None:
        self._search = search
        self._explained: set[int] = set()
        # Also what feeds only one of several inputs: that is what there is to explain.
        there = dict.fromkeys(search.roles())
        for position in search.relevant:
            for input in search.ask_at(position):
                there |= dict.fromkeys(search.offers((input,)))
        # In order, since the first of several is named.
        self._roles = [roles for roles in there if search.sorts.fit(roles)[0] is not Fit.NOT]
        self._allowed = frozenset(self._roles)

    def streams(self, input: Input, supply: Supply | None) -> Iterator[Alternative]:
        """Each stream with the feature: chosen, possible, or why not."""
        search = self._search
        chosen = _chosen_streams(supply)
        positions = list(search.candidates(input.feature))
        if supply is None and len(positions) < LISTED:
            # Streams about other objects are no candidates, but they tell what there is.
            index = search.space.streams_by_feature
            others = (p for name in search.serving(input.feature) for p in index.get(name, ()))
            positions = list(dict.fromkeys((*positions, *others)))
        positions.sort(key=lambda position: search.space.streams[position].stream not in chosen)
        for position in positions[:LISTED]:
            annotation = search.space.streams[position]
            fields = tuple(
                content.field
                for content in annotation.contents
                if content.feature in search.serving(input.feature)
            )
            text = stream_words(annotation.stream, annotation.contents, fields)
            if annotation.stream in chosen:
                yield Alternative(text, Outcome.CHOSEN)
            else:
                yield self._stream(annotation, input, text)
        if len(positions) > LISTED:
            more = len(positions) - LISTED
            yield Alternative(f"{more} more streams", Outcome.UNTRIED, "not listed")

    def _stream(self, annotation: StreamAnnotation, input: Input, text: str) -> Alternative:
        reasons: dict[str, None] = {}
        for content in annotation.contents:
            if content.feature not in self._search.serving(input.feature):
                continue
            fit, reason = self._search.sorts.fit(content.roles)
            reason = reason or why_not_convertible(content.unit, input.unit)
            if not reason:
                part = "" if fit is Fit.WHOLLY else "some of the objects"
                return Alternative(text, Outcome.POSSIBLE, part)
            reasons[reason] = None
        return Alternative(text, Outcome.FAILED, "; ".join(reasons))

    def units(self, ask: Ask, path: frozenset[str], supply: Supply | None) -> Iterator[Alternative]:
        """Each transformation that gives the feature: chosen, possible, not tried, or why not."""
        search = self._search
        chosen = _chosen_units(supply)
        direct = supply is not None and supply.complete and not chosen
        passed = False
        for position in search.producers(ask):
            unit = search.space.transformations[position]
            if unit.name in chosen:
                passed = True
                yield Alternative(unit_words(unit), Outcome.CHOSEN)
            elif direct or (passed and supply is not None and supply.complete):
                yield Alternative(unit_words(unit), Outcome.UNTRIED)
            elif search.through(ask, position, self._allowed, path) is not None:
                yield Alternative(unit_words(unit), Outcome.POSSIBLE)
            else:
                yield self._unit(ask, position, path)
        for name in search.serving(ask[0].feature):
            for position in search.space.transformations_by_output.get(name, ()):
                unit = search.space.transformations[position]
                if position not in search.producers(ask):
                    yield Alternative(unit_words(unit), Outcome.FAILED, _no_answer(unit, ask))

    def _unit(self, ask: Ask, position: int, path: frozenset[str]) -> Alternative:
        """Why this transformation gives nothing."""
        search = self._search
        unit = search.space.transformations[position]
        text = unit_words(unit)
        below = search.step(ask, position, path)
        if below is None:
            return Alternative(text, Outcome.FAILED, "a feature would stand twice on the path")
        if position in self._explained:
            return Alternative(text, Outcome.FAILED, "as said above")
        if len(path) >= EXPLAINED_DEPTH:
            return Alternative(text, Outcome.FAILED, "nothing further below gives its inputs")
        self._explained.add(position)
        lacking = []
        answers: list[dict[Roles, Found]] = []
        for input in search.ask_at(position):
            found = {
                roles: answer
                for roles in self._roles
                if (answer := search.find((input,), frozenset((roles,)), below)) is not None
            }
            answers.append(found)
            if not found:
                lacking.append(self._lacking(input, below))
        if lacking:
            return Alternative(text, Outcome.FAILED, "", tuple(lacking))
        return Alternative(text, Outcome.FAILED, self._apart(unit, answers))

    def _lacking(self, input: Input, path: frozenset[str]) -> Alternative:
        """An input that nothing gives."""
        parts = (*self.streams(input, None), *self.units((input,), path, None))
        failed = tuple(part for part in parts if part.outcome is Outcome.FAILED)
        reason = "" if failed else self.nothing_gives(input.feature)
        return Alternative(shorten(input.feature), Outcome.FAILED, reason, failed)

    def _apart(self, unit: TransformationDescription, answers: list[dict[Roles, Found]]) -> str:
        """Why inputs that can all be had do not come together."""
        common = [roles for roles in answers[0] if all(roles in found for found in answers)]
        if not common:
            pairs = (
                f"{shorten(port.feature)} of {whose(next(iter(found)))}"
                for port, found in zip(unit.inputs, answers, strict=True)
            )
            return f"its inputs speak of different objects: {', '.join(pairs)}"
        fed = [roles for roles in common if self._search.takes(unit, roles)]
        if not fed:
            return (
                f"it is for every {shorten(unit.sort)}, "
                f"and its input would be for {whose(common[0])}"
            )
        if len(answers) == 1:
            return f"more than {MAX_DEPTH} transformations would stand on one path"
        names = dict.fromkeys(_stream_name(found[fed[0]]) for found in answers)
        return f"needs synchronization of {' and '.join(names)}, which are different streams"

    def nothing_gives(self, feature: str) -> str:
        reason = f"no stream and no transformation gives {shorten(feature)}"
        sources = self._search.space.sources_by_feature.get(feature, ())
        if sources:
            name = self._search.space.sources[sources[0]].name
            reason += f" (source {name} would, but sources are not started on demand)"
        return reason


def _chosen_streams(supply: Supply | None) -> set[str]:
    """The streams in which the wanted feature itself was found."""
    if supply is None:
        return set()
    return {
        node.stream
        for source in supply.sources
        if not any(isinstance(node, Compute) for node in nodes_of(source.node))
        for node in nodes_of(source.node)
        if isinstance(node, UseStream)
    }


def _chosen_units(supply: Supply | None) -> set[str]:
    if supply is None:
        return set()
    nodes = (source.node for source in supply.sources)
    return {node.transformation for node in nodes if isinstance(node, Compute)}


def _no_answer(unit: TransformationDescription, ask: Ask) -> str:
    if not unit.inputs:
        return "it has no inputs: sources are not started on demand"
    reasons = (why_not_convertible(unit.output.unit, input.unit) for input in ask)
    return next((reason for reason in reasons if reason), "it gives only a part of what is needed")


def _stream_name(found: Found) -> str:
    """The stream an answer stands in: an existing one, or the output of a unit."""
    nodes = list(nodes_of(found.node))
    last = nodes[-1]
    if isinstance(last, Compute):
        return f"the output of {last.transformation}"
    return next(node.stream for node in nodes if isinstance(node, UseStream))

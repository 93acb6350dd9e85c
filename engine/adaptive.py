"""Adaptive subscriptions: to a feature and objects, not to a stream ([Introspection15 §4.4]).

The subscription keeps one output stream, while what it is made from changes: when a stream ends,
falls silent, loses quality or means something else, the manager matches again, only for the
subscriptions concerned, and switches them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import StrEnum

from ..languages.ssl.annotation import Content, Role, StreamAnnotation
from ..matching.plan import Compute, Detect, Supply, SupplySource, UseStream, nodes_of, ssl_of
from ..matching.subject import Sorts, Subject
from ..matching.want import Want
from ..ontology.vocabulary import THING, Vocabulary
from ..streams.generator import StreamGenerator
from ..streams.policy import Policy
from ..streams.time import SECOND
from .configuration import Configuration
from .describing import local
from .merge_unit import OBJECT, MergeInput, MergeUnit, Whose
from .stream_units import AdaptationUnit
from .views import Since

KEPT = 1000
"""So many switches of a subscription are remembered."""


class State(StrEnum):
    """How a subscription is."""

    RUNNING = "running"
    STALE = "stale"
    """It reads what there is, which is silent or too bad, and nothing better is known."""
    WAITING = "waiting"
    """Nothing gives what is wanted; it starts when something does."""


@dataclass(frozen=True, slots=True)
class Wish:
    """What is subscribed to, and when that is to be matched again.

    ``staleness`` (ns) is how long a source may be silent; None: as long as it has been used to.
    ``quality`` is the least that is good enough. A better plan is taken when it has been there for
    ``hold_off`` (ns).
    """

    want: Want
    strategy: str = "fast"
    policy: Policy = field(default_factory=Policy)
    since: Since = Since.NOW
    staleness: int | None = None
    quality: float = 0.0
    hold_off: int = 2 * SECOND


@dataclass(frozen=True, slots=True)
class Rematch:
    """A switch: after sample ``position`` of the subscription's stream, at ``time`` (ns), from
    ``before`` to ``after`` (the names of what is read), because of ``why``.

    ``lost`` says whether the new source had forgotten some of what followed the last sample.
    """

    time: int
    position: int
    why: str
    before: tuple[str, ...]
    after: tuple[str, ...]
    lost: bool = False


class AdaptiveSubscription:
    """One subscription at work. `unit` merges what `supply` says; ``adapted`` keeps the policy."""

    def __init__(
        self, id: str, wish: Wish, unit: MergeUnit, adapted: AdaptationUnit | None
    ) -> None:
        self.id = id
        self.wish = wish
        self.unit = unit
        self.adapted = adapted
        self.supply: Supply | None = None
        self.state = State.WAITING
        self.missing: tuple[str, ...] = ()
        self.reads: frozenset[str] = frozenset()
        """The streams behind it: those it reads, and those that these are made from."""
        self.made_by: frozenset[str] = frozenset()
        """The transformations of its plan."""
        self.misled = False
        """Whether what it reads means something else by now."""
        self.avoided: set[str] = set()
        """Streams and transformations that fell silent, until they speak again."""
        self.rematches: deque[Rematch] = deque(maxlen=KEPT)

    @property
    def output(self) -> StreamGenerator:
        """The stream that the subscriber reads."""
        return self.unit.output if self.adapted is None else self.adapted.output

    @property
    def leaves(self) -> tuple[str, ...]:
        """The streams and sources of its plan, each once."""
        if self.supply is None:
            return ()
        found: dict[str, None] = {}
        for source in self.supply.sources:
            for node in nodes_of(source.node):
                if isinstance(node, UseStream):
                    found[node.stream] = None
                elif isinstance(node, Compute) and not node.inputs:
                    found[node.transformation] = None
        return tuple(found)

    def rdf(self, vocabulary: Vocabulary) -> StreamAnnotation:
        """How its samples are written as triples: they are the wanted feature's, in its unit."""
        name = self.output.name
        want = self.wish.want
        info = vocabulary.feature(want.feature)
        unit = None if info is None else info.unit
        others = [Role(s.sort, s.object, f"{OBJECT}{i}") for i, s in enumerate(want.others, 2)]
        roles = (Role(want.wanted_sort, None, OBJECT), *others)
        contents = (Content(want.feature, value_field(want), unit or (), roles),)
        return StreamAnnotation(name, contents, ssl_of(name, contents))


def value_field(want: Want) -> str:
    """The field of a subscription's stream that holds the feature."""
    name = local(want.feature)
    return "value" if name == OBJECT else name


def merge_inputs(
    supply: Supply,
    streams: list[StreamGenerator],
    configuration: Configuration,
    vocabulary: Callable[[], Vocabulary],
) -> list[MergeInput]:
    """What a merge takes from each source of a supply; ``streams`` are the sources' streams."""
    return [
        MergeInput(
            generator,
            source.port.source_field,
            source.port.conversion,
            tuple(
                Whose(role.object, role.id_field, configuration.namespaces[generator.name])
                for role in source.roles[: 1 + len(supply.want.others)]
            ),
            _filter(supply.want, source, vocabulary),
        )
        for source, generator in zip(supply.sources, streams, strict=True)
    ]


def _filter(
    want: Want, source: SupplySource, vocabulary: Callable[[], Vocabulary]
) -> Callable[[str], bool] | None:
    """Which objects of a source are meant, where it speaks of others, too."""
    if want.object is not None:
        return None
    role = source.roles[0]
    sorts = Sorts(vocabulary())
    if role.object is not None or sorts.within(role.sort or THING, want.wanted_sort):
        return None
    return lambda iri: Sorts(vocabulary()).belongs(Subject(None, iri), want.wanted_sort)


def behind(unit: MergeUnit, configuration: Configuration) -> Iterator[str]:
    """The names of all streams whose samples reach the unit."""
    for part in configuration.units_behind(unit):
        for source in part.inputs:
            yield source.name


def transformations_of(supply: Supply) -> frozenset[str]:
    """The transformations of a plan."""
    names = set()
    for source in supply.sources:
        for node in nodes_of(source.node):
            if isinstance(node, Compute):
                names.add(node.transformation)
            elif isinstance(node, Detect):
                names.add(node.event)
    return frozenset(names)

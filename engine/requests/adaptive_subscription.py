"""Adaptive subscriptions: to a feature and objects, not to a stream ([Introspection15 §4.4]).

The subscription keeps one output stream, while what it is made from changes: when a stream ends,
falls silent, loses quality or means something else, the manager matches again, only for the
subscriptions concerned, and switches them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from ...languages.ssl.annotation import Content, Role, StreamAnnotation
from ...languages.ssl.annotation_text import with_ssl_source
from ...languages.ssl.check import variable_name
from ...matching.plan import (
    Compute,
    Detect,
    Node,
    Supply,
    SupplySource,
    UseStream,
    nodes_of,
    nodes_of_supply,
)
from ...matching.strategy import Kind, Strategy
from ...matching.subject import Sorts, Subject
from ...matching.want import Want
from ...ontology.vocabulary import THING, Vocabulary
from ...streams.generator import StreamGenerator
from ...streams.policies.policy import Policy
from ...streams.time import SECOND
from ..configuration.configuration import Configuration
from ..model.beginning import Beginning
from ..model.views import Since
from ..units.merge import OBJECT, MergeInput, MergeUnit, Whose
from ..units.policy import AdaptationUnit

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
    ``hold_off`` (ns). The policy holds for each object by itself if it ``is_keyed``.
    """

    want: Want
    strategy: str = "fast"
    policy: Policy = field(default_factory=Policy)
    since: Beginning = Since.NOW
    staleness: int | None = None
    quality: float = 0.0
    hold_off: int = 2 * SECOND
    is_keyed: bool = False

    @property
    def kind(self) -> Kind:
        """By what the strategy chooses."""
        return Strategy.parse(self.strategy).kind

    @property
    def minds_quality(self) -> bool:
        """Whether it matters how good a plan is."""
        return self.quality > 0 or self.kind in (Kind.QUALITY, Kind.WEIGHTED)


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
        self.streams: tuple[StreamGenerator, ...] = ()
        """The streams of the sources of its supply."""
        self.quality = 1.0
        """How good its supply was when that was last looked at."""
        self.has_begun = False
        """Whether it has ever read anything."""
        self.state = State.WAITING
        self.missing: tuple[str, ...] = ()
        self.reads: frozenset[str] = frozenset()
        """The streams behind it: those it reads, and those that these are made from."""
        self.made_by: frozenset[str] = frozenset()
        """The transformations of its plan."""
        self.misled = False
        """Whether a unit of its plan has said that its stream means something else by now."""
        self.avoided: set[str] = set()
        """Streams and transformations that fell silent or failed, until they speak again or some
        time is over."""
        self.young: dict[str, int] = {}
        """Streams and transformations that might be better, and since when (ns) they are there:
        none of them is taken for that before its hold-off."""
        self.timed: set[str] = set()
        """Those of them that do not speak for themselves, and are looked at when it is time."""
        self.watched: set[StreamGenerator] = set()
        """Those of which it is settled when they are looked at next."""
        self.looks_again = False
        """Whether it is settled when it is matched again."""
        self.rematches: deque[Rematch] = deque(maxlen=KEPT)

    @property
    def begins(self) -> Beginning:
        """What a plan for it begins with: with the past, too, once it has read anything."""
        return Since.START if self.has_begun else self.wish.since

    @property
    def output(self) -> StreamGenerator:
        """The stream that the subscriber reads."""
        return self.unit.output if self.adapted is None else self.adapted.output

    @property
    def nodes(self) -> tuple[Node, ...]:
        """The nodes of its plan, inputs first."""
        return () if self.supply is None else nodes_of_supply(self.supply)

    @property
    def leaves(self) -> tuple[str, ...]:
        """The streams and sources of its plan, each once."""
        found: dict[str, None] = {}
        for node in self.nodes:
            if isinstance(node, UseStream):
                found[node.stream] = None
            elif isinstance(node, Compute) and not node.inputs:
                found[node.transformation] = None
        return tuple(found)

    def nodes_behind(self, stream: StreamGenerator) -> tuple[Node, ...]:
        """The nodes of its plan that ``stream``, which it reads, is made from."""
        if self.supply is None:
            return ()
        read = zip(self.supply.sources, self.streams, strict=True)
        return tuple(
            node for source, own in read if own is stream for node in nodes_of(source.node)
        )

    def rdf(self, vocabulary: Vocabulary) -> StreamAnnotation:
        """How its samples are written as triples: they are the wanted feature's, in its unit."""
        name = self.output.name
        want = self.wish.want
        info = vocabulary.feature(want.feature)
        unit = None if info is None else info.unit
        others = [Role(s.sort, s.object, f"{OBJECT}{i}") for i, s in enumerate(want.others, 2)]
        roles = (Role(want.wanted_sort, None, OBJECT), *others)
        contents = (Content(want.feature, value_field(want), unit or (), roles),)
        return with_ssl_source(StreamAnnotation(name, contents, ""), vocabulary)


def value_field(want: Want) -> str:
    """The field of a subscription's stream that holds the feature."""
    name = variable_name(want.feature)
    return "value" if name == OBJECT else name


def merge_inputs(
    supply: Supply,
    streams: Sequence[StreamGenerator],
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


def transformations_of(nodes: Iterable[Node]) -> frozenset[str]:
    """The transformations among the nodes of a plan."""
    names = set()
    for node in nodes:
        if isinstance(node, Compute):
            names.add(node.transformation)
        elif isinstance(node, Detect):
            names.add(node.event)
    return frozenset(names)


def names_of(nodes: Iterable[Node]) -> frozenset[str]:
    """The streams and transformations among the nodes of a plan."""
    nodes = tuple(nodes)
    streams = frozenset(node.stream for node in nodes if isinstance(node, UseStream))
    return streams | transformations_of(nodes)

"""Adaptive subscriptions: to a feature and objects, not to a stream ([Introspection15 §4.4]).

A subscription keeps one output stream while its sources change. When a source ends, becomes silent,
loses quality or changes its meaning, `Rematching` matches the affected subscriptions again and
switches their sources.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
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
    UseStream,
    nodes_of,
    nodes_of_supply,
)
from ...matching.strategy import Kind, Strategy
from ...matching.want import Want
from ...ontology.vocabulary import Vocabulary
from ...streams.generator import StreamGenerator
from ...streams.policies.policy import Policy
from ...streams.time import SECOND
from ..configuration.configuration import Configuration
from ..model.beginning import Beginning
from ..model.views import Since
from ..units.merge import OBJECT, MergeUnit
from ..units.policy import AdaptationUnit

MAX_REMATCHES = 1000
"""The number of latest switches that a subscription remembers."""


class State(StrEnum):
    """The state of a subscription."""

    RUNNING = "running"
    STALE = "stale"
    """Its sources are silent or below the wanted quality, and there are no better ones."""
    WAITING = "waiting"
    """No stream or transformation provides the feature; it starts when one does."""


@dataclass(frozen=True, slots=True)
class Wish:
    """The feature of a subscription, and the conditions for matching it again.

    ``staleness`` (ns): how long a source may be silent; None: as long as its usual intervals imply.
    ``quality``: the least acceptable quality. A better plan is taken when it has existed for
    ``hold_off`` (ns). ``is_keyed``: the policy applies to each object separately.
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
        """The kind of the strategy."""
        return Strategy.parse(self.strategy).kind

    @property
    def considers_quality(self) -> bool:
        """Whether the quality of plans matters."""
        return self.quality > 0 or self.kind in (Kind.QUALITY, Kind.WEIGHTED)


@dataclass(frozen=True, slots=True)
class Rematch:
    """A switch after sample ``position`` of the output, at ``time`` (ns), from the sources
    ``before`` to the sources ``after`` (names), for the reason ``why``.

    ``lost``: the new source has evicted samples after the last one that the subscription got.
    """

    time: int
    position: int
    why: str
    before: tuple[str, ...]
    after: tuple[str, ...]
    lost: bool = False


class AdaptiveSubscription:
    """A running subscription. `unit` merges the sources of `supply`; ``adaptation`` applies the
    policy."""

    def __init__(
        self, id: str, wish: Wish, unit: MergeUnit, adaptation: AdaptationUnit | None
    ) -> None:
        self.id = id
        self.wish = wish
        self.unit = unit
        self.adaptation = adaptation
        self.supply: Supply | None = None
        self.streams: tuple[StreamGenerator, ...] = ()
        """The streams of the sources of its supply."""
        self.quality = 1.0
        """The quality of its supply when it was last computed."""
        self.has_begun = False
        """Whether it has ever read anything."""
        self.state = State.WAITING
        self.missing: tuple[str, ...] = ()
        self.reads: frozenset[str] = frozenset()
        """Names of the streams that it reads, directly or through units."""
        self.transformations: frozenset[str] = frozenset()
        """The transformations of its plan."""
        self.has_new_meaning = False
        """Whether the annotation of a unit's stream in its plan has changed."""
        self.avoided: set[str] = set()
        """Silent streams and failed transformations, until they bring samples again or some time
        has passed."""
        self.candidates: dict[str, int] = {}
        """Streams and transformations that might be better, and the time (ns) since which they
        exist. They are not used before the hold-off has passed."""
        self.timed_candidates: set[str] = set()
        """Those candidates for which an alarm is set, since no samples of their own announce
        them."""
        self.watched_sources: set[StreamGenerator] = set()
        """The sources for whose next check an alarm is set."""
        self.will_match = False
        """Whether an alarm is set for the next match."""
        self.rematches: deque[Rematch] = deque(maxlen=MAX_REMATCHES)

    @property
    def beginning(self) -> Beginning:
        """The beginning of its next plan. Once it has read samples a new source includes its
        history, so that the merge can continue without a gap."""
        return Since.START if self.has_begun else self.wish.since

    @property
    def output(self) -> StreamGenerator:
        """The stream that the subscriber reads."""
        return self.unit.output if self.adaptation is None else self.adaptation.output

    @property
    def nodes(self) -> tuple[Node, ...]:
        """The nodes of its plan, inputs first."""
        return () if self.supply is None else nodes_of_supply(self.supply)

    @property
    def source_names(self) -> tuple[str, ...]:
        """The streams and sources of its plan, each once."""
        found: dict[str, None] = {}
        for node in self.nodes:
            if isinstance(node, UseStream):
                found[node.stream] = None
            elif isinstance(node, Compute) and not node.inputs:
                found[node.transformation] = None
        return tuple(found)

    def nodes_behind(self, stream: StreamGenerator) -> tuple[Node, ...]:
        """The nodes of its plan that produce ``stream``, one of its sources."""
        if self.supply is None:
            return ()
        read = zip(self.supply.sources, self.streams, strict=True)
        return tuple(
            node for source, own in read if own is stream for node in nodes_of(source.node)
        )

    def rdf(self, vocabulary: Vocabulary) -> StreamAnnotation:
        """Return the annotation by which its samples convert to triples. Cost: some 0.2 ms."""
        contents = self.contents(vocabulary)
        return with_ssl_source(StreamAnnotation(self.output.name, contents, ""), vocabulary)

    def contents(self, vocabulary: Vocabulary) -> tuple[Content, ...]:
        """Return what its samples contain: the wanted feature, in the feature's unit."""
        want = self.wish.want
        info = vocabulary.feature(want.feature)
        unit = None if info is None else info.unit
        others = [Role(s.sort, s.object, f"{OBJECT}{i}") for i, s in enumerate(want.others, 2)]
        roles = (Role(want.wanted_sort, None, OBJECT), *others)
        return (Content(want.feature, value_field(want), unit or (), roles),)


def value_field(want: Want) -> str:
    """Return the field of a subscription's stream that contains the feature."""
    name = variable_name(want.feature)
    return "value" if name == OBJECT else name


def upstream_names(unit: MergeUnit, configuration: Configuration) -> Iterator[str]:
    """Yield the names of all streams that the unit reads, directly or through units."""
    for part in configuration.upstream_units(unit):
        for source in part.inputs:
            yield source.name


def transformations_of(nodes: Iterable[Node]) -> frozenset[str]:
    """Return the names of the transformations in a plan."""
    names = set()
    for node in nodes:
        if isinstance(node, Compute):
            names.add(node.transformation)
        elif isinstance(node, Detect):
            names.add(node.event)
    return frozenset(names)


def names_of(nodes: Iterable[Node]) -> frozenset[str]:
    """Return the names of the streams and transformations in a plan."""
    nodes = tuple(nodes)
    streams = frozenset(node.stream for node in nodes if isinstance(node, UseStream))
    return streams | transformations_of(nodes)

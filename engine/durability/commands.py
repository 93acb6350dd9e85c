"""The changes of an engine, as values that the journal stores and replays.

An engine is a function of its commands: the same commands in the same order make the same streams
with the same samples and numbers, in another process too. The journal relies on this
(docs/explanation/design/0007-the-journal.md). A command therefore contains everything that its
effect depends on, time included, as clients sent it: texts, and batches as bytes.

The written form (MessagePack, a map with the member ``do``) is a promise: new members have
defaults, and no member changes its meaning. tests/cases/journal has one of each.

The file is long because it is the list of this format.
"""

from __future__ import annotations

import hashlib
from itertools import islice
from typing import Any, Final, Literal, TypeAlias

import msgspec
import numpy as np
from pyoxigraph import RdfFormat

from ...continuous.algebra.options import Bounds, Report, Semantics
from ...converters.arrow.sizes import declares_more
from ...converters.arrow.stream import decode_arrow
from ...converters.errors import AheadOfClock, ConversionError, WireError
from ...converters.ndjson import decode_ndjson
from ...converters.ndjson_lines import sample_lines
from ...converters.rdf.statements import check_statements, decode_statements
from ...converters.wire import BatchLimits, Incoming
from ...languages.errors import LanguageError
from ...languages.specification import Specification
from ...languages.ssl.annotation import CheckedAnnotation
from ...ontology.errors import OntologyError, QueryRefused
from ...ontology.ontology import PreparedOntology
from ...ontology.texts.reading import TextFormat
from ...streams.generator import StreamGenerator
from ...streams.history import FluentStream
from ...streams.past_queries import Forgotten
from ...streams.sample import Schema
from ...streams.stream_rules import UNIQUE_TIMES
from ...streams.string_pool import StringPool
from ...streams.time import SECOND, TIME_MAX, format_duration, format_time
from ..catalog.iri_annotations import DescribedStream, DescribedTransformation
from ..catalog.registered_transformations import TransformationView
from ..engine import Engine
from ..model.errors import Conflict, DyknowError
from ..model.views import (
    DeclarationView,
    EventView,
    QueryView,
    Since,
    SpecificationView,
    StreamDeclaration,
    StreamView,
    SubscriptionView,
    TemplateView,
)
from ..processes.external_io import Outcome, Reading
from ..units.backlog import TurnRecord

BatchKind: TypeAlias = Literal["ndjson", "arrow", "ntriples", "nquads", "turtle", "trig"]
RDF_FORMATS: Final[dict[BatchKind, RdfFormat]] = {
    "ntriples": RdfFormat.N_TRIPLES,
    "nquads": RdfFormat.N_QUADS,
    "turtle": RdfFormat.TURTLE,
    "trig": RdfFormat.TRIG,
}
"""The kinds of batches for streams of RDF."""

REFUSALS = (
    DyknowError,
    LanguageError,
    ConversionError,
    OntologyError,
    QueryRefused,
    Forgotten,
    ValueError,
)
"""Errors of a refused command: it has changed nothing that the client asked for."""


class Command(
    msgspec.Struct, frozen=True, tag_field="do", omit_defaults=True, forbid_unknown_fields=True
):
    """A change of the engine. `apply` raises the errors of the engine's method, and changes nothing
    then."""

    def apply(self, engine: Engine) -> Any:
        raise NotImplementedError


class Tick(Command, frozen=True, tag="tick"):
    """Advance the time to ``now`` (ns). ``readings``: the results of sources, recorded for
    replay."""

    now: int
    readings: tuple[Reading, ...] = ()

    def apply(self, engine: Engine) -> None:
        engine.tick(self.now)


class Publish(Command, frozen=True, tag="publish"):
    """Publish a batch that arrived at ``now`` (ns)."""

    stream: str
    kind: BatchKind
    body: bytes
    now: int
    key: str | None = None
    """The Idempotency-Key."""

    def apply(self, engine: Engine) -> int:
        return self.apply_decoded(engine, self.decode(engine))

    def is_large(self, most: int) -> bool:
        """Whether the body has more than ``most`` bytes, decompressed."""
        if len(self.body) > most:
            return True
        return self.kind == "arrow" and declares_more(self.body, most)

    def decode(self, engine: Engine, limits: BatchLimits | None = None) -> Incoming:
        """Decode the batch by the present fields of the stream. Raises `WireError`, also for a
        batch beyond ``limits``. A replay passes no limits, since the batch was accepted."""
        generator = engine.accepting(self.stream)
        property = self.time_property(engine, generator)
        return self._decode(generator.schema, generator.stream.pools, limits, property)

    def time_property(self, engine: Engine, stream: StreamGenerator) -> str:
        """Return the property that gives the times of statements of ``stream``; empty where none
        does. Raises `Conflict` for a text of RDF to a stream of samples."""
        property = engine.time_property(stream)
        if property is None and self.kind in RDF_FORMATS:
            raise Conflict(
                f"stream {self.stream!r} takes samples, and this is RDF",
                'declare a stream of RDF: PUT /streams/NAME {"kind": "rdf"}',
            )
        return property or ""

    def decode_beside(
        self, stream: FluentStream, schema: Schema, limits: BatchLimits, time_property: str = ""
    ) -> Incoming:
        """Decode the batch by ``schema`` in another thread than the engine's.

        It changes nothing that the engine's thread reads: texts get codes of pools of their own.
        The stream gives them its codes when it takes the batch, so a replay gives the same codes.
        """
        incoming = self._decode(schema, {}, limits, time_property)
        stream.find_places(incoming.batch)
        return incoming

    def _decode(
        self,
        schema: Schema,
        pools: dict[str, StringPool],
        limits: BatchLimits | None,
        time_property: str,
    ) -> Incoming:
        format = RDF_FORMATS.get(self.kind)
        if format is not None:
            return decode_statements(self.body, format, pools, limits, time_property)
        decode = decode_ndjson if self.kind == "ndjson" else decode_arrow
        return decode(self.body, schema, pools, limits)

    def check(self, engine: Engine, incoming: Incoming) -> None:
        """Raise `AheadOfClock` where a sample is stamped further ahead of the clock, ``now``, than
        its stream allows (SPEC §5, "Time of windows"), and `WireError` for samples that are no
        statements in a stream of RDF.

        Contract: call it once for a batch from a client, before execution, and never in a replay.
        """
        generator = engine.accepting(self.stream)
        if self.kind not in RDF_FORMATS and engine.time_property(generator) is not None:
            try:
                check_statements(incoming.batch)
            except WireError:
                # Decoding has put its texts into the stream's pools.
                generator.forget_texts()
                raise
        # A repeated batch has no effect, so its times do not matter.
        if incoming.stamped or engine.intake.is_used(generator, self.key):
            return
        latest = min(self.now + generator.ahead, TIME_MAX)
        available = incoming.batch.available
        if int(available.max()) <= latest:
            return
        row = int(np.argmax(available > latest))
        time = int(available[row])
        line: int | None = row + 1
        what = "'available'"
        if self.kind == "ndjson":
            line, _ = next(islice(sample_lines(self.body), row, None))
        elif self.kind in RDF_FORMATS:
            line, what = None, "the time of a statement"
        raise AheadOfClock(
            line,
            f"{what} is {format_time(time)}, {format_duration(time - self.now)} ahead of the "
            f"clock; stream {self.stream!r} takes {format_duration(generator.ahead)} at most",
            'correct the time; declare the stream of a simulation with "ahead": "oo"',
            latest,
        )

    def apply_decoded(self, engine: Engine, incoming: Incoming) -> int:
        """`apply` with the decoded batch."""
        # Only batches with a key are compared with earlier ones, so the others need no digest.
        digest = b"" if self.key is None else hashlib.blake2b(self.body, digest_size=16).digest()
        return engine.publish(self.stream, incoming, self.now, self.key, digest)


class Begin(Command, frozen=True, tag="begin"):
    """Begin a new ``epoch`` at ``now`` (ns), written by ``program``. The first command of a log.

    Ids of events contain ``epoch``. ``processes``: the modules of user-written processes, by name
    of the process. ``rules`` (`Rules.version`) hold for the commands that follow; early programs
    wrote none and had the first rules.
    """

    epoch: str
    now: int
    program: str
    processes: dict[str, str] = {}
    rules: int = UNIQUE_TIMES

    def apply(self, engine: Engine) -> None:
        engine.epoch = self.epoch
        engine.rules.version = self.rules


class Refused(Command, frozen=True, tag="refused"):
    """A command that was refused. The journal keeps it because it may have used up a number, or
    stopped a query that was no longer valid."""

    command: bytes

    def apply(self, engine: Engine) -> None:
        try:
            decode_command(self.command).apply(engine)
        except REFUSALS:
            return


class WorkBacklog(Command, frozen=True, tag="go on"):
    """Close the windows and take the parts that ``done`` records (`Backlog.work`)."""

    done: tuple[TurnRecord, ...] = ()

    def apply(self, engine: Engine) -> None:
        engine.replay_turns(self.done)


class ReportSinkFailures(Command, frozen=True, tag="sinks"):
    """Report failures of sinks that earlier commands called. A replay does not call sinks, so the
    journal stores their failures."""

    outcomes: tuple[Outcome, ...]

    def apply(self, engine: Engine) -> None:
        engine.report_sink_failures(self.outcomes)


class ReportUnkept(Command, frozen=True, tag="unkept"):
    """Report on the status stream that checkpoints lack the state of ``process``, with the
    ``reason``."""

    process: str
    reason: str

    def apply(self, engine: Engine) -> None:
        engine.report_unkept(self.process, self.reason)


class EndStream(Command, frozen=True, tag="end stream"):
    stream: str

    def apply(self, engine: Engine) -> None:
        engine.end(self.stream)


class DeclareStream(Command, frozen=True, tag="declare stream"):
    declaration: StreamDeclaration

    def apply(self, engine: Engine) -> StreamView:
        return engine.declare(self.declaration)


class RemoveStream(Command, frozen=True, tag="remove stream"):
    stream: str

    def apply(self, engine: Engine) -> None:
        engine.remove_stream(self.stream)


class OpenStream(Command, frozen=True, tag="open stream"):
    """Create a stream that exists from the first request for it: late samples, violations."""

    stream: str

    def apply(self, engine: Engine) -> None:
        engine.generator(self.stream)


class SetQuality(Command, frozen=True, tag="set quality"):
    stream: str
    quality: float

    def apply(self, engine: Engine) -> None:
        engine.set_quality(self.stream, self.quality)


class Annotate(Command, frozen=True, tag="annotate"):
    ssl: str

    def apply(self, engine: Engine) -> tuple[CheckedAnnotation, ...]:
        return engine.annotate(self.ssl)


class Describe(Command, frozen=True, tag="describe"):
    described: tuple[DescribedStream, ...]
    transformations: tuple[DescribedTransformation, ...] | None = None

    def apply(self, engine: Engine) -> tuple[CheckedAnnotation, ...]:
        return engine.describe_all(self.described, self.transformations or ())


class RegisterTemplate(Command, frozen=True, tag="register template"):
    text: str
    replace: bool = False

    def apply(self, engine: Engine) -> TemplateView:
        return engine.register_template(self.text, replace=self.replace)


class RemoveTemplate(Command, frozen=True, tag="remove template"):
    name: str

    def apply(self, engine: Engine) -> None:
        engine.remove_template(self.name)


class RequestEvent(Command, frozen=True, tag="request event"):
    """Request an event by its ``text``, or by its name and the texts of its arguments."""

    text: str | None = None
    event: str = ""
    arguments: tuple[str, ...] = ()
    strategy: str = "fast"
    since: str = Since.NOW

    def apply(self, engine: Engine) -> EventView:
        if self.text is None:
            request = engine.make_request(self.event, self.arguments)
        else:
            request = engine.parse_request(self.text)
        return engine.request_event(request, self.strategy, self.since)


class CancelEvent(Command, frozen=True, tag="cancel event"):
    id: str

    def apply(self, engine: Engine) -> None:
        engine.cancel_event(self.id)


class Subscribe(Command, frozen=True, tag="subscribe"):
    stream: str
    policy: str = ""
    unit: str = "ms"
    since: str = Since.NOW
    keyed: bool | None = None
    """Whether the policy applies to each object separately; None, in journals of earlier versions,
    means no."""

    def apply(self, engine: Engine) -> SubscriptionView:
        keyed = self.keyed is True
        return engine.subscribe(self.stream, self.policy, self.unit, self.since, keyed=keyed)


class SubscribeToFeature(Command, frozen=True, tag="subscribe to feature"):
    """Subscribe to a feature; durations in ns."""

    feature: str
    sort: str | None = None
    objects: tuple[str, ...] = ()
    strategy: str = "fast"
    policy: str = ""
    unit: str = "ms"
    since: str = Since.NOW
    staleness: int | None = None
    quality: float = 0.0
    hold_off: int = 2 * SECOND
    keyed: bool | None = None

    def apply(self, engine: Engine) -> SubscriptionView:
        return engine.subscribe_to_feature(
            self.feature,
            sort=self.sort,
            objects=self.objects,
            strategy=self.strategy,
            policy=self.policy,
            unit=self.unit,
            since=self.since,
            staleness=self.staleness,
            quality=self.quality,
            hold_off=self.hold_off,
            keyed=self.keyed is True,
        )


class Unsubscribe(Command, frozen=True, tag="unsubscribe"):
    id: str

    def apply(self, engine: Engine) -> None:
        engine.unsubscribe(self.id)


class RegisterQuery(Command, frozen=True, tag="register query"):
    text: str
    semantics: Semantics | None = None
    bounds: Bounds = "(]"
    origin: int = 0
    report: Report = "non-empty"
    strategy: str = "fast"
    since: str = Since.NOW
    name: str = ""
    """The name of a query whose text has none. The journal stores it, so that another program that
    replays the command gives the query the same name."""

    def apply(self, engine: Engine) -> QueryView:
        return engine.queries.register(
            self.text,
            semantics=self.semantics,
            bounds=self.bounds,
            origin=self.origin,
            report=self.report,
            strategy=self.strategy,
            since=self.since,
            name=self.name,
        )


class RemoveQuery(Command, frozen=True, tag="remove query"):
    name: str

    def apply(self, engine: Engine) -> None:
        engine.queries.remove(self.name)


class AddKpl(Command, frozen=True, tag="add kpl"):
    text: str
    unit: str = "ms"

    def apply(self, engine: Engine) -> tuple[DeclarationView, ...]:
        return engine.add_kpl(self.text, self.unit)


class RemoveKpl(Command, frozen=True, tag="remove kpl"):
    name: str
    cascade: bool = False

    def apply(self, engine: Engine) -> tuple[str, ...]:
        return engine.remove_kpl(self.name, cascade=self.cascade)


class ApplySpecification(Command, frozen=True, tag="apply specification"):
    text: bytes

    def apply(self, engine: Engine) -> SpecificationView:
        return engine.apply_specification(self.text)

    def apply_prepared(self, engine: Engine, specification: Specification) -> SpecificationView:
        """`apply` with the parsed text."""
        return engine.take_specification(specification)


class LoadOntology(Command, frozen=True, tag="load ontology"):
    text: str
    name: str
    format: TextFormat = "turtle"

    def apply(self, engine: Engine) -> None:
        engine.load_ontology(self.text, name=self.name, format=self.format)

    def apply_prepared(self, engine: Engine, prepared: PreparedOntology) -> None:
        """`apply` with the parsed text."""
        engine.take_ontology(prepared)


class RemoveOntology(Command, frozen=True, tag="remove ontology"):
    name: str

    def apply(self, engine: Engine) -> None:
        engine.remove_ontology(self.name)

    def apply_prepared(self, engine: Engine, prepared: PreparedOntology) -> None:
        """`apply` with the closure of the other ontologies."""
        engine.take_removal(self.name, prepared)


class RegisterTransformations(Command, frozen=True, tag="register transformations"):
    described: tuple[DescribedTransformation, ...]
    replace: bool = False

    def apply(self, engine: Engine) -> tuple[TransformationView, ...]:
        return engine.transformations.register_all(self.described, replace=self.replace)


class RegisterAnnotatedTransformation(
    Command, frozen=True, tag="register annotated transformation"
):
    ssl: str
    implementation: str | None = None
    parameters: dict[str, str] | None = None
    cost: float = 1.0
    quality: float = 1.0
    replace: bool = False

    def apply(self, engine: Engine) -> tuple[TransformationView, ...]:
        view = engine.transformations.register_annotated(
            self.ssl,
            implementation=self.implementation,
            parameters=self.parameters,
            cost=self.cost,
            quality=self.quality,
            replace=self.replace,
        )
        return (view,)


class ChangeTransformation(Command, frozen=True, tag="change transformation"):
    name: str
    cost: float | None = None
    quality: float | None = None

    def apply(self, engine: Engine) -> TransformationView:
        engine.transformations.change(self.name, cost=self.cost, quality=self.quality)
        return engine.transformations.view(self.name)


class RemoveTransformation(Command, frozen=True, tag="remove transformation"):
    name: str

    def apply(self, engine: Engine) -> None:
        engine.transformations.remove(self.name)


AnyCommand: TypeAlias = (
    Begin
    | Refused
    | ReportUnkept
    | Tick
    | Publish
    | WorkBacklog
    | ReportSinkFailures
    | EndStream
    | DeclareStream
    | RemoveStream
    | OpenStream
    | SetQuality
    | Annotate
    | Describe
    | RegisterTemplate
    | RemoveTemplate
    | RequestEvent
    | CancelEvent
    | Subscribe
    | SubscribeToFeature
    | Unsubscribe
    | RegisterQuery
    | RemoveQuery
    | AddKpl
    | RemoveKpl
    | ApplySpecification
    | LoadOntology
    | RemoveOntology
    | RegisterTransformations
    | RegisterAnnotatedTransformation
    | ChangeTransformation
    | RemoveTransformation
)
# KPL is not among them: the ontology stores declarations that cannot be restored.
DEFINING = (
    DeclareStream,
    Annotate,
    Describe,
    RegisterTemplate,
    RequestEvent,
    Subscribe,
    SubscribeToFeature,
    RegisterQuery,
    ApplySpecification,
    LoadOntology,
    RegisterTransformations,
    RegisterAnnotatedTransformation,
)
"""Commands that define objects which exist until a user removes them."""
_ENCODER = msgspec.msgpack.Encoder()
_DECODER: msgspec.msgpack.Decoder[AnyCommand] = msgspec.msgpack.Decoder(AnyCommand)


ParsedBody: TypeAlias = Incoming | PreparedOntology | Specification
"""The decoded batch or parsed text of a command. The service parses outside of the engine's thread,
and the engine does not parse again."""


ANYTIME: Final = (Publish, Tick, EndStream)
"""Commands that are safe while a window is half done, since units defer their input then. Before
any other command the window has to be closed."""


def execute(engine: Engine, command: Command, parsed: ParsedBody | None = None) -> Any:
    """Execute ``command``, with its ``parsed`` body if there is one; return its result."""
    match command, parsed:
        case Publish(), Incoming():
            return command.apply_decoded(engine, parsed)
        case LoadOntology() | RemoveOntology(), PreparedOntology():
            return command.apply_prepared(engine, parsed)
        case ApplySpecification(), Specification():
            return command.apply_prepared(engine, parsed)
        case _:
            return command.apply(engine)


def encode_command(command: Command) -> bytes:
    """Encode a command as bytes; the inverse of `decode_command`."""
    return _ENCODER.encode(command)


def decode_command(data: bytes) -> Command:
    """Decode a command. Raises ``msgspec.DecodeError``."""
    return _DECODER.decode(data)

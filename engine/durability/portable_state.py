"""The part of an engine's state that every version of the program can restore.

The triples of the ontology contain the definitions (ontologies, templates, annotations,
declarations, KPL, specifications, queries), and `AcceptedCommands` the accepted commands without a
name. Streams that clients publish to, and those of registered queries, keep their samples, counters
and numbers. The rest is computed anew: open windows, and the streams of other units, whose numbers
start again. The ids of events therefore get a new epoch.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import msgspec
import numpy as np

from ...ontology.ontology import Ontology
from ...streams.generator import Counters, StreamGenerator
from ...streams.sample import (
    Column,
    Field,
    FieldType,
    SampleBatch,
    Schema,
    concatenate,
)
from ...streams.stream_rules import UNIQUE_TIMES
from ...streams.string_pool import StringPool
from ..configuration.configuration import after_reserved
from ..configuration.ingest import UsedKey
from ..engine import Engine
from .accepted_commands import AcceptedCommands
from .checkpoint import Outside
from .commands import AnyCommand, Command, RegisterQuery
from .process_state import Unkept


class KeptColumn(msgspec.Struct):
    """Values of one field, little-endian as in numpy; for text, indexes of ``texts``."""

    type: FieldType
    values: bytes
    null: bytes | None
    texts: list[str] | None = None


class KeptStream(msgspec.Struct):
    """A stream that clients publish to, or of a query's results. ``first`` is the number of its
    oldest sample; the last ``pending`` rows are held back within the lateness. Times in ns,
    little-endian int64. ``complete_since`` is `FluentStream.complete_since`; None: an earlier
    version wrote it."""

    name: str
    fields: list[Field]
    first: int
    pending: int
    available: bytes
    valid: bytes
    columns: dict[str, KeptColumn]
    counters: Counters
    stamped: bool | None
    watermark: int | None
    is_ended: bool
    complete_since: int | None = None


class Portable(msgspec.Struct):
    """The written form; its member names are in checkpoints and do not change.

    ``quads``: N-Quads. ``standing``: accepted commands without a name, oldest first. ``keys``:
    Idempotency-Keys of batches. ``processes``: modules of the user-written processes in use, by
    name of the process; ``unkept``: process states that the checkpoint lacks. ``waiting``: accepted
    commands that could not be replayed. ``ids``: those of ``standing``, then the next free ones.
    ``waiting_ids``: those of ``waiting``, and ``waiting_after``: how many of ``standing`` were
    accepted before each. ``rules``: the rules in force. ``results``: the streams of registered
    queries; earlier versions stored none.
    """

    format: int
    now: int
    quads: bytes
    streams: list[KeptStream]
    standing: list[AnyCommand]
    keys: list[UsedKey] = []
    processes: dict[str, str] = {}
    unkept: list[Unkept] = []
    waiting: list[AnyCommand] = []
    ids: list[str] = []
    waiting_ids: list[str] = []
    waiting_after: list[int] = []
    rules: int = UNIQUE_TIMES
    results: list[KeptStream] = []


class PortableHead(msgspec.Struct):
    """The members of `Portable` that are read before the state is unpickled."""

    processes: dict[str, str] = {}
    unkept: list[Unkept] = []


def portable_of(
    engine: Engine,
    accepted: AcceptedCommands,
    processes: Mapping[str, str],
    unkept: Iterable[Unkept],
) -> Portable:
    """Return the portable state of ``engine``. Cost: O(samples kept)."""
    # A stream without fields has had no samples.
    kept = [each for each in engine.published() if each.schema.fields]
    named = dict(engine.ontology.registered.queries)
    unnamed: dict[str, Command] = {}
    waiting: list[tuple[str, int, Command]] = []
    for key, one in accepted.all():
        if one.is_waiting:
            # At the next start each copy counts as one user again (`add_waiting`).
            waiting += [(key.name, len(unnamed), one.command)] * one.users
        elif key.name not in named:
            unnamed[key.name] = one.command
    return Portable(
        1,
        engine.now,
        engine.ontology.quads(),
        [_stream_state(each) for each in kept],
        list(unnamed.values()),  # type: ignore[arg-type]
        list(engine.intake.keys),
        dict(processes),
        list(unkept),
        [command for _, _, command in waiting],  # type: ignore[misc]
        [*unnamed, *engine.next_ids],
        [id for id, _, _ in waiting],
        [after for _, after, _ in waiting],
        engine.rules.version,
        [_stream_state(engine.generator(name)) for name in _query_streams(engine)],
    )


def engine_from(
    portable: Portable,
    now: int,
    outside: Outside,
    first_reserved: int = 1,
) -> tuple[Engine, AcceptedCommands, list[str]]:
    """Restore an engine in a new epoch; return it, its accepted commands, and messages about
    losses. ``first_reserved``: as for `Engine`, beyond the names of queries that a replay will
    register."""
    engine = Engine(
        # The clock may have been set back, and the time of an engine never decreases.
        now=max(now, portable.now),
        first_reserved=max(first_reserved, after_reserved((*portable.ids, *portable.waiting_ids))),
        ontology=Ontology.from_quads(portable.quads),
        rules=portable.rules,
        **outside.arguments(),
    )
    lost = []
    there = {each.name: each for each in engine.published()}
    for kept in portable.streams:
        generator = there.get(kept.name)
        if generator is None:
            lost.append(
                f"stream {kept.name} is no longer declared; its {_count(kept)} samples were not "
                "restored"
            )
        else:
            lost += _restore_stream(generator, kept)
    engine.intake.restore_keys(each for each in portable.keys if each.stream in there)
    restarted = set(_query_streams(engine))
    for kept in portable.results:
        # A query over the streams of the engine itself may have given results at the start; samples
        # of before cannot follow those.
        if kept.name in restarted and not engine.generator(kept.name).stream.last_number:
            lost += _restore_stream(engine.generator(kept.name), kept)
    for text in lost:
        engine.report_not_restored(text)
    accepted = AcceptedCommands()
    for id, command in _commands_of(portable):
        engine.keep_id(id)
        if isinstance(command, RegisterQuery):
            # Users know an unnamed query by the name that it had.
            command = msgspec.structs.replace(command, name=id)
        reason = accepted.replay(command, engine)
        if reason is not None:
            lost.append(f"not restored, and kept: {reason}")
    for next_id in portable.ids[len(portable.standing) :]:
        engine.keep_id(next_id)
    return engine, accepted, lost


def _query_streams(engine: Engine) -> list[str]:
    """Return the result streams of the registered queries, which have the names of the queries."""
    named = dict(engine.ontology.registered.queries)
    return [name for name in engine.queries.names() if name in named and engine.queries.has(name)]


def _commands_of(portable: Portable) -> Iterator[tuple[str, AnyCommand]]:
    """Yield executed and waiting commands with their ids, in the order of acceptance. Earlier
    versions stored no ids, or none of waiting commands."""
    count = len(portable.standing)
    ids = portable.ids[:count] or [""] * count
    behind: dict[int, list[tuple[str, AnyCommand]]] = {}
    missing = len(portable.waiting) - len(portable.waiting_ids)
    waiting = zip(
        [*portable.waiting_ids, *[""] * missing],
        [*portable.waiting_after, *[count] * missing],
        portable.waiting,
        strict=True,
    )
    for id, after, command in waiting:
        behind.setdefault(after, []).append((id, command))
    for i, own in enumerate(zip(ids, portable.standing, strict=True)):
        yield from behind.get(i, ())
        yield own
    yield from behind.get(count, ())


def _stream_state(generator: StreamGenerator) -> KeptStream:
    stream, pending = generator.stream, generator.pending
    batch = concatenate([stream.all(), pending]) if len(pending) else stream.all()
    return KeptStream(
        generator.name,
        list(generator.schema.fields),
        stream.first_number,
        len(pending),
        batch.available.tobytes(),
        batch.valid.tobytes(),
        {name: _column(column) for name, column in batch.columns.items()},
        generator.counters,
        generator.stamped,
        generator.watermark,
        generator.is_ended,
        stream.complete_since,
    )


def _column(column: Column) -> KeptColumn:
    null = None if column.null is None else column.null.tobytes()
    if column.pool is None:
        return KeptColumn(column.type, column.values.tobytes(), null)
    # The pool of the stream may have many texts that no kept sample has.
    own = column.recoded(StringPool())
    assert own.pool is not None
    return KeptColumn(column.type, own.values.tobytes(), null, list(own.pool.strings()))


def _count(kept: KeptStream) -> int:
    return len(kept.available) // np.dtype(np.int64).itemsize


def _restore_stream(generator: StreamGenerator, kept: KeptStream) -> list[str]:
    """Restore the samples and numbers of ``generator``, which is unused yet; return messages about
    fields that it does not have. Its numbers continue in any case."""
    schema = Schema(tuple(kept.fields))
    if generator.is_open:
        pools = {f.name: StringPool() for f in schema.fields if f.type is FieldType.STRING}
        generator.adopt(schema, pools)
    count, lost = _count(kept), []
    if generator.schema != schema:
        left = [f"{f.name} ({f.type})" for f in schema.fields if f not in generator.schema.fields]
        new = [f"{f.name} ({f.type})" for f in generator.schema.fields if f not in schema.fields]
        lost.append(
            f"stream {kept.name} has other fields than before: of its {count} samples "
            f"{', '.join(left) or 'nothing'} was not restored"
            + (f", and they have no value of {', '.join(new)}" if new else "")
        )
    columns = {}
    for field in generator.schema.fields:
        column = kept.columns.get(field.name)
        if column is None or column.type is not field.type:
            column = KeptColumn(
                field.type,
                np.zeros(count, field.type.dtype).tobytes(),
                np.ones(count, np.bool_).tobytes(),
                [""] if field.type is FieldType.STRING else None,
            )
        values = np.frombuffer(column.values, column.type.dtype)
        null = None if column.null is None else np.frombuffer(column.null, np.bool_)
        pool = None if column.texts is None else StringPool(column.texts)
        found = Column(column.type, values, null, pool)
        columns[field.name] = (
            found if pool is None else found.recoded(generator.stream.pools[field.name])
        )
    available, valid = (np.frombuffer(each, np.int64) for each in (kept.available, kept.valid))
    generator.go_on(
        SampleBatch(available, valid, columns),
        kept.first,
        kept.pending,
        kept.counters,
        stamped=kept.stamped,
        watermark=kept.watermark,
        is_ended=kept.is_ended,
        complete_since=kept.complete_since,
    )
    return lost

"""What of an engine's state any version of the program can go on from.

Definitions (ontologies, templates, annotations, declarations, KPL, specifications, queries) are in
the triples of the ontology; what was asked for without a name is in `Standing`; and streams that
people publish to keep their samples, counters and numbers. What is not in it is computed anew:
windows that were open, and the streams that units make, whose numbers begin again. So it is not the
same life of the engine, and the ids of its events say so.
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
from .accepted_commands import Standing
from .checkpoint import Outside
from .commands import AnyCommand, Command, RegisterQuery
from .process_state import Unkept


class KeptColumn(msgspec.Struct):
    """Values of one field, little-endian as numpy has them; of text codes of the ``texts``."""

    type: FieldType
    values: bytes
    null: bytes | None
    texts: list[str] | None = None


class KeptStream(msgspec.Struct):
    """A stream that people publish to. ``first`` is the number of its oldest sample kept; the last
    ``pending`` rows are held back within the lateness. Times in ns, little-endian int64."""

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


class Portable(msgspec.Struct):
    """``quads``: N-Quads. ``standing``: what was asked for and has no name, oldest first.
    ``keys``: those under which batches came. ``processes``: the modules of the user-written ones
    that are needed, by their names; ``unkept``: those that remember what is not in the state.
    ``waiting``: what was accepted and could not be done again. ``ids``: those of ``standing``, then
    those that would be given next. ``waiting_ids``: those of ``waiting``, and ``waiting_after``:
    behind how many of ``standing`` each was accepted. ``rules``: those that held."""

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


class PortableHead(msgspec.Struct):
    """What of a `Portable` is of interest before a state is read."""

    processes: dict[str, str] = {}
    unkept: list[Unkept] = []


def portable_of(
    engine: Engine,
    standing: Standing,
    processes: Mapping[str, str] | None = None,
    unkept: Iterable[Unkept] = (),
) -> Portable:
    """What of ``engine`` any version understands. Cost: O(samples kept)."""
    kept = [each for each in engine.published() if each.schema.fields]
    named = engine.ontology.registered.queries()
    unnamed: dict[str, Command] = {}
    waiting: list[tuple[str, int, Command]] = []
    for key, asked in standing.all():
        if asked.is_waiting:
            waiting += [(key.name, len(unnamed), asked.command)] * asked.times
        elif key.name not in named:
            unnamed[key.name] = asked.command
    return Portable(
        1,
        engine.now,
        engine.ontology.quads(),
        [_kept(each) for each in kept],
        list(unnamed.values()),  # type: ignore[arg-type]
        list(engine.intake.keys),
        dict(processes or {}),
        list(unkept),
        [command for _, _, command in waiting],  # type: ignore[misc]
        [*unnamed, *engine.next_ids],
        [id for id, _, _ in waiting],
        [after for _, after, _ in waiting],
        engine.rules.version,
    )


def engine_from(
    portable: Portable,
    now: int,
    outside: Outside,
    first_reserved: int = 1,
) -> tuple[Engine, Standing, list[str]]:
    """An engine that goes on from there in a life of its own, what stands in it, and what could not
    be had again. ``first_reserved`` as of `Engine`, beyond the names of queries that come again."""
    engine = Engine(
        now=max(now, portable.now),
        first_reserved=max(first_reserved, after_reserved((*portable.ids, *portable.waiting_ids))),
        ontology=Ontology.of_quads(portable.quads),
        rules=portable.rules,
        **outside.given(),
    )
    lost = []
    there = {each.name: each for each in engine.published()}
    for kept in portable.streams:
        generator = there.get(kept.name)
        if generator is None:
            lost.append(
                f"stream {kept.name}: nobody declares it any more; its {_count(kept)} samples are "
                "not taken over"
            )
        else:
            lost += _restore(generator, kept)
    engine.intake.remember(each for each in portable.keys if each.stream in there)
    for text in lost:
        engine.tell_not_restored(text)
    standing = Standing()
    for id, command in _asked(portable):
        engine.keep_id(id)
        if isinstance(command, RegisterQuery):
            command = msgspec.structs.replace(command, name=id)
        reason = standing.again(command, engine)
        if reason is not None:
            lost.append(f"not restored, and kept: {reason}")
    for next_id in portable.ids[len(portable.standing) :]:
        engine.keep_id(next_id)
    return engine, standing, lost


def _asked(portable: Portable) -> Iterator[tuple[str, AnyCommand]]:
    """What stood and what waited, with its ids, in the order in which it was accepted: by their ids
    people give them up. Earlier versions kept no ids, or none of what waited."""
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
    for i, asked in enumerate(zip(ids, portable.standing, strict=True)):
        yield from behind.get(i, ())
        yield asked
    yield from behind.get(count, ())


def _kept(generator: StreamGenerator) -> KeptStream:
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
    )


def _column(column: Column) -> KeptColumn:
    null = None if column.null is None else column.null.tobytes()
    if column.pool is None:
        return KeptColumn(column.type, column.values.tobytes(), null)
    own = column.recoded(StringPool())
    assert own.pool is not None
    return KeptColumn(column.type, own.values.tobytes(), null, list(own.pool.strings()))


def _count(kept: KeptStream) -> int:
    return len(kept.available) // np.dtype(np.int64).itemsize


def _restore(generator: StreamGenerator, kept: KeptStream) -> list[str]:
    """Let ``generator``, that nobody has used yet, go on from what was kept; gives what of that it
    has no place for. Its numbers go on in any case."""
    schema = Schema(tuple(kept.fields))
    if generator.is_open:
        pools = {f.name: StringPool() for f in schema.fields if f.type is FieldType.STRING}
        generator.adopt(schema, pools)
    count, lost = _count(kept), []
    if generator.schema != schema:
        left = [f"{f.name} ({f.type})" for f in schema.fields if f not in generator.schema.fields]
        new = [f"{f.name} ({f.type})" for f in generator.schema.fields if f not in schema.fields]
        lost.append(
            f"stream {kept.name} has other fields than it had: of its {count} samples "
            f"{', '.join(left) or 'nothing'} is not taken over"
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
    )
    return lost

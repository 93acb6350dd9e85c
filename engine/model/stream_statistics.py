"""The view of a stream, its rate, and its flow for cost estimates."""

from __future__ import annotations

from collections.abc import Iterable

from ...continuous.estimation.input_rates import ASSUMED_SUBJECTS, Flow, PredicateRate
from ...languages.ssl.annotation import Content, StreamAnnotation
from ...rdf.namespaces import RDF_TYPE
from ...streams.generator import StreamGenerator
from ...streams.time import SECOND
from .views import StreamView

_RECENT = 1_000
"""The number of last samples over which the rate is computed."""


def stream_view(
    generator: StreamGenerator,
    namespace: str,
    producer: str | None,
    annotation: StreamAnnotation | None,
    contents: tuple[Content, ...],
    time_property: str | None,
) -> StreamView:
    """Return the stream's present state; ``producer`` is the name of the process that makes it,
    if the system does. ``time_property``: as in `StreamDeclaration`.

    Cost: O(1), and a look at the last few batches for rate and lag.
    """
    stream = generator.stream
    recent = stream.since(max(stream.first_number, stream.last_number - 1))
    last_available = int(recent[-1].batch.available[-1]) if recent else 0
    last_valid = int(recent[-1].batch.valid[-1]) if recent else None
    return StreamView(
        name=generator.name,
        fields=generator.schema.fields,
        namespace=namespace,
        lateness=generator.lateness,
        idle=generator.idle,
        ahead=generator.ahead,
        is_idle=generator.is_idle,
        retention=stream.retention,
        stamped=generator.stamped,
        ended=generator.is_ended,
        counters=generator.counters,
        samples_kept=len(stream),
        first_number=stream.first_number,
        last_number=stream.last_number,
        watermark=generator.watermark,
        first_available=stream.first_available,
        last_available=stream.last_available,
        last_valid=last_valid,
        rate=present_rate(generator),
        lag=last_available - last_valid if last_valid is not None else None,
        annotation=None if annotation is None else annotation.source,
        contents=contents,
        producer=producer,
        subscribers=generator.subscribers + generator.listeners,
        time_property=time_property,
    )


def present_rate(generator: StreamGenerator) -> float:
    """Return the samples per second that come: 0 from a stream that has ended."""
    return 0.0 if generator.is_ended else rate_of(generator)


def rate_of(generator: StreamGenerator) -> float:
    """Return the samples per second of available time over the last thousand samples. Cost: a look
    at the last few batches."""
    stream = generator.stream
    recent = stream.since(max(stream.first_number, stream.last_number - _RECENT))
    if not recent:
        return 0.0
    number = sum(len(segment.batch) for segment in recent)
    span = int(recent[-1].batch.available[-1]) - int(recent[0].batch.available[0])
    return (number - 1) * SECOND / max(span, SECOND)


def flow_of(generator: StreamGenerator, annotations: Iterable[StreamAnnotation]) -> Flow | None:
    """Return the flow of triples that a query over the stream may expect, for cost estimates; None
    if the stream has no rate.

    It assumes that each sample has a value in each field. The number of a sort's objects is not
    known here, so `ASSUMED_SUBJECTS` stands for it.
    """
    rate = rate_of(generator)
    if not rate:
        return None
    said: dict[str, PredicateRate] = {}
    for content in (content for one in annotations for content in one.contents):
        subject = content.roles[0] if content.roles else None
        of_sort = subject is not None and subject.sort is not None
        said[content.feature] = PredicateRate(rate, ASSUMED_SUBJECTS if of_sort else 1.0)
        if of_sort:
            said[RDF_TYPE.value] = PredicateRate(rate, ASSUMED_SUBJECTS, 1.0)
    subjects = None if RDF_TYPE.value in said or not said else 1.0
    return Flow(rate, subjects, said or None)

"""Terms forgotten at every chance: what holds ids without saying so is found out.

`at_every_chance` makes every safe point a sweep, however few terms have come, and every call of an
evaluator or reader a safe point. *reused*: what comes next gets the ids that were freed, so that
who still has them sees other terms. *retired*: no term ever gets them, and reading one raises.

Texts are forgotten at every chance, too: each batch of a stream of which nobody keeps codes gives
its fields new pools (`FluentStream.forget_texts`).
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import numpy as np

from dyknow.continuous.columns.relation import TermValues
from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.sharing.template_instances import TemplateEvaluator
from dyknow.converters.rdf.ntriples import TripleReader
from dyknow.rdf.dictionary import ForgottenTerm, TermDictionary
from dyknow.rdf.timed import Kind
from dyknow.streams import history

WAYS = ("reused", "retired")
_EVALUATORS = (ContinuousEvaluator, TemplateEvaluator)


@contextmanager
def at_every_chance(way: str) -> Iterator[None]:
    """Sweep at every chance; ``way`` is one of `WAYS`."""
    assert way in WAYS
    with _patched(TermDictionary, "collect", lambda _: _sweep if way == "reused" else _retire):
        patches = [
            _patched(evaluator, name, _then_sweeps(lambda one: one._windows.terms.dictionary))
            for evaluator in _EVALUATORS
            for name in ("push", "advance", "end", "resume", "next_end", "limit")
        ]
        patches += [
            _patched(TemplateEvaluator, name, _then_sweeps(lambda e: e._windows.terms.dictionary))
            for name in ("add", "remove")
        ]
        patches += [
            _patched(TripleReader, name, _then_sweeps(lambda one: one.dictionary))
            for name in ("triples", "graphs")
        ]
        patches += [_patched(TermValues, n, _checked) for n in ("canonical", "encode", "typed")]
        with _all(patches), texts_at_every_chance():
            yield


@contextmanager
def texts_at_every_chance() -> Iterator[None]:
    """However few texts have come, and although they come again."""
    with patch.multiple(history, _TEXTS=-1, _SHARE=-1, _AGAIN=2):
        yield


def _sweep(dictionary: TermDictionary) -> int:
    return dictionary._sweep()


def _retire(dictionary: TermDictionary) -> int:
    freed = dictionary._sweep()
    dictionary._free.clear()
    dictionary._next = len(dictionary._terms)
    return freed


def _then_sweeps(dictionary_of: Callable[[Any], TermDictionary]) -> Callable[[Any], Any]:
    """A method that has a sweep after it, but within another such call or the engine's own."""

    def wrapped(method: Callable[..., Any]) -> Callable[..., Any]:
        def call(self: Any, *args: Any, **kwargs: Any) -> Any:
            result = method(self, *args, **kwargs)
            dictionary_of(self).collect()
            return result

        return call

    return wrapped


def _checked(method: Callable[..., Any]) -> Callable[..., Any]:
    """What terms are worth is asked only of terms that are there."""

    def call(self: TermValues, column: Any, *args: Any) -> Any:
        if column.kind is Kind.TERM and len(column.held_ids):
            dictionary, ids = self.dictionary, np.unique(column.held_ids)
            gone = [id for id in ids.tolist() if id >= 0 and dictionary._terms[id] is None]
            if gone:
                raise ForgottenTerm(f"{gone} have been forgotten")
        return method(self, column, *args)

    return call


@contextmanager
def _patched(owner: type, name: str, wrapper: Callable[[Any], Any]) -> Iterator[None]:
    with patch.object(owner, name, wrapper(getattr(owner, name))):
        yield


@contextmanager
def _all(patches: list[Any]) -> Iterator[None]:
    if not patches:
        yield
        return
    with patches[0], _all(patches[1:]):
        yield

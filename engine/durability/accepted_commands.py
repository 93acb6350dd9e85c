"""What people have asked for that no definition in the ontology keeps: requests, subscriptions,
queries without a name; and what was accepted once and cannot be done by this program.

What cannot be done now (a module is missing, another version refuses it) waits under the very id
that it has had: nothing else gets that id meanwhile, by it people can give it up, and under it the
next program tries again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import msgspec

from ...continuous.algebra.options import Options
from ...languages.csparql import parse_query, parse_template
from ...languages.csparql.ast import Dialect
from ...languages.errors import LanguageError
from ...languages.ssl import ast, parse_ssl
from ...rdf.namespaces import local_name, shorten
from ..engine import Engine
from ..model.beginning import Beginning, parse_beginning, start_from_retained
from ..model.errors import UNKNOWN
from ..model.views import QueryView
from ..planning.registrations import Asked as AskedQuery
from ..planning.registrations import Registration, usual_semantics
from .commands import (
    REFUSALS,
    Annotate,
    CancelEvent,
    Command,
    DeclareStream,
    Describe,
    LoadOntology,
    ReadAlready,
    RegisterAnnotatedTransformation,
    RegisterQuery,
    RegisterTemplate,
    RegisterTransformations,
    RemoveQuery,
    RemoveStream,
    RemoveTemplate,
    RemoveTransformation,
    RequestEvent,
    Subscribe,
    SubscribeToFeature,
    Unsubscribe,
    done,
    written,
)

REQUEST, SUBSCRIPTION, QUERY = "request", "subscription", "query"
"""Kinds of what waits."""
_UNIT = "transformation"


class Key(NamedTuple):
    """What a command makes: its kind, and the id or name by which people give it up."""

    kind: str
    name: str


_REMOVED: dict[type[Command], tuple[str, ...]] = {
    CancelEvent: (REQUEST,),
    Unsubscribe: (SUBSCRIPTION,),
    RemoveQuery: (QUERY,),
    RemoveStream: ("stream", "annotation"),
    RemoveTransformation: (_UNIT,),
    RemoveTemplate: ("template",),
}
"""Commands whose one member is what they remove, and the kinds that it may be of."""


@dataclass(frozen=True, slots=True)
class Asked:
    """``command`` was accepted once, for ``times`` users. Unless ``is_waiting`` it is done."""

    command: Command
    is_waiting: bool
    times: int = 1
    reason: str = ""
    """Why it waits."""


@dataclass(frozen=True, slots=True)
class Waiting:
    """``command``, of ``users`` people, that would make what ``key`` says, and why it does not."""

    key: Key
    command: Command
    reason: str
    users: int


class Standing:
    """The commands whose results have no name by which the ontology would keep them, and those
    that wait; oldest first."""

    def __init__(self) -> None:
        self._asked: dict[Key, Asked] = {}
        self._waiting: dict[Key, None] = {}

    def all(self) -> Iterator[tuple[Key, Asked]]:
        """What is done, and what waits, in the order in which it was accepted."""
        yield from self._asked.items()

    def waiting(self) -> Iterator[tuple[Key, Command]]:
        """What was accepted and could not be done again."""
        return ((key, self._asked[key].command) for key in self._waiting)

    def waiting_views(self) -> tuple[Waiting, ...]:
        """The same, for people."""
        asked = ((key, self._asked[key]) for key in self._waiting)
        return tuple(Waiting(key, one.command, one.reason, one.times) for key, one in asked)

    def do(self, engine: Engine, command: Command, known: ReadAlready | None = None) -> Any:
        """Do ``command``, see `commands.done`; what is to be removed may be waiting."""
        try:
            return done(engine, command, known)
        except UNKNOWN:
            if not self.give_up(command):
                raise
            return None

    def note(self, command: Command, found: Any) -> None:
        """``command`` was done, and gave ``found``."""
        match command:
            case RequestEvent():
                self._done(Key(REQUEST, found.id), command)
            case Subscribe() | SubscribeToFeature():
                self._done(Key(SUBSCRIPTION, found.id), command)
            case CancelEvent(id=id):
                self._ended(Key(REQUEST, id))
            case Unsubscribe(id=id):
                self._ended(Key(SUBSCRIPTION, id))
            case RegisterQuery():
                self._done(Key(QUERY, found.name), command)
            case RemoveQuery(name=name):
                self._ended(Key(QUERY, name))
            case _ if self._waiting:
                # What was said anew counts, and of what was taken back nothing comes again.
                for key in (*_defines(command), *self._removed(command)):
                    self._forget(key)

    def expected(self, command: Command, engine: Engine) -> Key | None:
        """What ``command`` is going to make, before it is done; None: nothing with an id."""
        match command:
            case RequestEvent():
                return Key(REQUEST, engine.next_ids[0])
            case Subscribe() | SubscribeToFeature():
                return Key(SUBSCRIPTION, engine.next_ids[1])
            case RegisterQuery(text=text, name=name):
                # The same one again, without a name, was one with a user more.
                meant = _unnamed(command)
                same = (key for key, other in self.waiting() if _unnamed(other) == meant)
                return next(same, None) or Key(QUERY, engine.queries.name_for(text, name))
            case _:
                return None

    def wait(self, command: Command, key: Key | None, engine: Engine, error: Exception) -> str:
        """``command`` was accepted by an earlier run and is refused now: it waits as ``key``, see
        `expected`, which is given to nothing else. The reason is told, and given."""
        if key is None:
            for own, part in _parts(command):
                self._wait(own, part, str(error))
            reason = f"{error}\n{command}"
        else:
            engine.skip_id(key.name)
            self._wait(key, command, str(error))
            reason = f"{key.kind} {key.name}: {error}\n{command}"
        engine.tell_not_restored(reason)
        return reason

    def again(self, command: Command, engine: Engine) -> str | None:
        """Do what an earlier run has accepted; where that is refused now it waits, and the reason
        is told."""
        key = self.expected(command, engine)
        try:
            self.note(command, _done_again(command, engine))
        except REFUSALS as error:
            return self.wait(command, key, engine, error)
        return None

    def give_up(self, command: Command) -> bool:
        """Do ``command``, by which something is removed that the engine does not know: it waits.
        Whether it did."""
        keys = self._removed(command)
        for key in keys:
            asked = self._asked[key]
            if asked.times > 1:
                self._asked[key] = replace(asked, times=asked.times - 1)
            else:
                self._forget(key)
        return bool(keys)

    def _done(self, key: Key, command: Command) -> None:
        known = self._asked.get(key)
        if known is None or known.is_waiting:
            self._asked[key] = Asked(command, is_waiting=False)
            self._waiting.pop(key, None)

    def _wait(self, key: Key, command: Command, reason: str) -> None:
        known = self._asked.get(key)
        is_shared = key.kind == QUERY and known is not None and known.is_waiting
        times = known.times + 1 if known is not None and is_shared else 1
        self._asked[key] = Asked(command, True, times, reason)
        self._waiting[key] = None

    def _ended(self, key: Key) -> None:
        """It was removed from the engine: what waits is not what was there."""
        if key not in self._waiting:
            self._asked.pop(key, None)

    def _forget(self, key: Key) -> None:
        self._asked.pop(key, None)
        self._waiting.pop(key, None)

    def _removed(self, command: Command) -> tuple[Key, ...]:
        """What of that which waits ``command`` removes."""
        kinds = _REMOVED.get(type(command), ())
        if not kinds:
            return ()
        name = next(iter(msgspec.structs.astuple(command)))
        return tuple(key for key in self._waiting if key.kind in kinds and name in _spellings(key))


def _done_again(command: Command, engine: Engine) -> Any:
    """What ``command`` gives. One that begins at a moment of which its streams have forgotten a
    part since begins with what they keep."""
    match command:
        case RequestEvent() | Subscribe() | SubscribeToFeature() | RegisterQuery():

            def begun(since: Beginning) -> Any:
                return msgspec.structs.replace(command, since=str(since)).apply(engine)

            return start_from_retained(parse_beginning(command.since), begun)
        case _:
            return command.apply(engine)


def _unnamed(command: Command) -> Command:
    """The command as it was asked for: which name is free is no part of that."""
    if isinstance(command, RegisterQuery) and command.name:
        return msgspec.structs.replace(command, name="")
    return command


def query_view(waiting: Waiting) -> QueryView:
    """A query that waits, as it was asked for; of a text that is not understood any more there is
    less to say."""
    command = waiting.command
    assert isinstance(command, RegisterQuery)
    try:
        query = parse_query(command.text)
    except LanguageError:
        query = None
    dialect = Dialect.C_SPARQL if query is None else query.dialect
    semantics = command.semantics or usual_semantics(dialect)
    options = Options(semantics, command.bounds, command.origin, command.report)
    asked = AskedQuery(
        command.text.strip(), options, command.strategy, parse_beginning(command.since)
    )
    registration = (
        Registration(0, asked, "", "", "") if query is None else Registration.of(0, asked, query)
    )
    return registration.view(waiting.key.name, "waiting", waiting.reason, waiting.users)


def _spellings(key: Key) -> Iterable[str]:
    """How people may write the name."""
    if key.kind == "template":
        return key.name, shorten(key.name), local_name(key.name)
    return (key.name,)


def _defines(command: Command) -> tuple[Key, ...]:
    """What people say there is to be, by the names under which they take it back."""
    match command:
        case DeclareStream(declaration=declaration):
            return (Key("stream", declaration.name),)
        case LoadOntology(name=name):
            return (Key("ontology", name),)
        case RegisterTransformations(described=described):
            return tuple(Key(_UNIT, each.name) for each in described)
        case Describe(described=described):
            return tuple(Key("annotation", each.stream) for each in described)
        case _:
            try:
                return _read(command)
            except LanguageError:
                return ()


def _read(command: Command) -> tuple[Key, ...]:
    """The same of a text; raises `LanguageError` for one that this program does not understand."""
    match command:
        case RegisterTemplate(text=text):
            return (Key("template", parse_template(text).name),)
        case Annotate(ssl=ssl) | RegisterAnnotatedTransformation(ssl=ssl):
            return tuple(
                Key("annotation" if isinstance(each, ast.StreamDeclaration) else _UNIT, each.name)
                for each in parse_ssl(ssl)
            )
        case _:
            return ()


def _parts(command: Command) -> Iterator[tuple[Key, Command]]:
    """The commands that make one thing each, of which ``command`` is made."""
    keys = _defines(command)
    match command:
        case RegisterTransformations(described=described):
            for key, unit in zip(keys, described, strict=True):
                yield key, msgspec.structs.replace(command, described=(unit,))
        case Describe(described=streams):
            for key, stream in zip(keys, streams, strict=True):
                yield key, msgspec.structs.replace(command, described=(stream,))
        case _ if len(keys) == 1:
            yield keys[0], command
        case _:
            # Nothing takes it back; said twice it is the same.
            digest = hashlib.blake2b(written(command), digest_size=8).hexdigest()
            yield Key("command", digest), command

"""The accepted commands that the ontology does not store: requests, subscriptions and unnamed
queries; and accepted commands that this program cannot execute.

A command that fails after a restart (a module is missing, another version refuses it) waits under
the id that it had. Nothing else gets that id meanwhile, users can remove the command by it, and the
next start tries the command again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import msgspec

from ...continuous.algebra.options import Options
from ...languages.errors import LanguageError
from ...languages.ssl import ast, parse_ssl
from ...languages.templates import parse_any_template
from ...ontology.graphs import ontology_graph
from ...rdf.namespaces import local_name, shorten
from ..engine import Engine
from ..model.beginning import Beginning, parse_beginning, start_from_retained
from ..model.errors import UNKNOWN
from ..model.views import QueryView
from ..planning.registrations import (
    Registration,
    Submission,
    parse_registered,
    usual_semantics,
)
from .commands import (
    REFUSALS,
    Annotate,
    CancelEvent,
    Command,
    DeclareStream,
    Describe,
    LoadOntology,
    ParsedBody,
    RegisterAnnotatedTransformation,
    RegisterQuery,
    RegisterTemplate,
    RegisterTransformations,
    RemoveOntology,
    RemoveQuery,
    RemoveStream,
    RemoveTemplate,
    RemoveTransformation,
    RequestEvent,
    Subscribe,
    SubscribeToFeature,
    Unsubscribe,
    encode_command,
    execute,
)

REQUEST, SUBSCRIPTION, QUERY = "request", "subscription", "query"
"""Kinds of keys that have ids of their own."""
_UNIT = "transformation"


class Key(NamedTuple):
    """The kind of object that a command creates, and the id or name by which users remove it."""

    kind: str
    name: str


_REMOVING: dict[type[Command], tuple[str, ...]] = {
    CancelEvent: (REQUEST,),
    Unsubscribe: (SUBSCRIPTION,),
    RemoveQuery: (QUERY,),
    RemoveStream: ("stream", "annotation"),
    RemoveTransformation: (_UNIT,),
    RemoveTemplate: ("template",),
    RemoveOntology: ("ontology",),
}
"""Commands whose only member names an object to remove, and the kinds that it may have."""


@dataclass(frozen=True, slots=True)
class Accepted:
    """An accepted ``command`` and the number of its users. It was executed unless
    ``is_waiting``."""

    command: Command
    is_waiting: bool
    users: int = 1
    reason: str = ""
    """Why it waits."""


@dataclass(frozen=True, slots=True)
class WaitingCommand:
    """A command that waits, the key of the object that it would create, and why it failed."""

    key: Key
    command: Command
    reason: str
    users: int


class AcceptedCommands:
    """Accepted commands whose results the ontology does not store, and waiting commands; oldest
    first."""

    def __init__(self) -> None:
        self._accepted: dict[Key, Accepted] = {}
        self._waiting: dict[Key, None] = {}

    def all(self) -> Iterator[tuple[Key, Accepted]]:
        """Iterate over executed and waiting commands in the order of acceptance."""
        yield from self._accepted.items()

    def waiting(self) -> Iterator[tuple[Key, Command]]:
        """Iterate over the waiting commands."""
        return ((key, self._accepted[key].command) for key in self._waiting)

    def waiting_views(self) -> tuple[WaitingCommand, ...]:
        """The waiting commands with their reasons, for users."""
        accepted = ((key, self._accepted[key]) for key in self._waiting)
        return tuple(
            WaitingCommand(key, one.command, one.reason, one.users) for key, one in accepted
        )

    def do(self, engine: Engine, command: Command, parsed: ParsedBody | None = None) -> Any:
        """Execute ``command`` (`commands.execute`). Where it removes an object that the engine does
        not know, remove the waiting command of that name."""
        try:
            return execute(engine, command, parsed)
        except UNKNOWN:
            if not self.remove_waiting(command):
                raise
            return None

    def record(self, command: Command, result: Any) -> None:
        """Record that ``command`` was executed with the ``result``."""
        match command:
            case RequestEvent():
                self._add_executed(Key(REQUEST, result.id), command)
            case Subscribe() | SubscribeToFeature():
                self._add_executed(Key(SUBSCRIPTION, result.id), command)
            case CancelEvent(id=id):
                self._remove_executed(Key(REQUEST, id))
            case Unsubscribe(id=id):
                self._remove_executed(Key(SUBSCRIPTION, id))
            case RegisterQuery():
                self._add_executed(Key(QUERY, result.name), command)
            case RemoveQuery(name=name):
                self._remove_executed(Key(QUERY, name))
            case _ if self._waiting:
                # A new definition replaces a waiting one, and a removal cancels it.
                for key in (*_defined_keys(command), *self._waiting_keys(command)):
                    self._discard(key)

    def expected_key(self, command: Command, engine: Engine) -> Key | None:
        """The key of the object that ``command`` will create; None: one without an id."""
        match command:
            case RequestEvent():
                return Key(REQUEST, engine.next_ids[0])
            case Subscribe() | SubscribeToFeature():
                return Key(SUBSCRIPTION, engine.next_ids[1])
            case RegisterQuery(text=text, name=name):
                # Registering an equal unnamed query again adds a user to the same query.
                meant = _without_name(command)
                same = (key for key, other in self.waiting() if _without_name(other) == meant)
                return next(same, None) or Key(QUERY, engine.queries.name_for(text, name))
            case _:
                return None

    def add_waiting(
        self, command: Command, key: Key | None, engine: Engine, error: Exception
    ) -> str:
        """Let ``command``, which an earlier run accepted and this one refuses, wait under ``key``
        (`expected_key`). Reserves the id of ``key``; reports the reason and returns it."""
        if key is None:
            for own_key, part in _split(command):
                self._put_waiting(own_key, part, str(error))
            reason = f"{error}\n{command}"
        else:
            engine.skip_id(key.name)
            self._put_waiting(key, command, str(error))
            reason = f"{key.kind} {key.name}: {error}\n{command}"
        engine.report_not_restored(reason)
        return reason

    def replay(self, command: Command, engine: Engine) -> str | None:
        """Execute a command that an earlier run accepted. If it is refused now, let it wait and
        return the reason."""
        key = self.expected_key(command, engine)
        try:
            self.record(command, _execute_again(command, engine))
        except REFUSALS as error:
            return self.add_waiting(command, key, engine, error)
        return None

    def remove_waiting(self, command: Command) -> bool:
        """Remove the waiting commands that ``command`` names, or one of their users; return whether
        there was one."""
        keys = self._waiting_keys(command)
        for key in keys:
            accepted = self._accepted[key]
            if accepted.users > 1:
                self._accepted[key] = replace(accepted, users=accepted.users - 1)
            else:
                self._discard(key)
        return bool(keys)

    def _add_executed(self, key: Key, command: Command) -> None:
        accepted = self._accepted.get(key)
        if accepted is None or accepted.is_waiting:
            self._accepted[key] = Accepted(command, is_waiting=False)
            self._waiting.pop(key, None)

    def _put_waiting(self, key: Key, command: Command, reason: str) -> None:
        accepted = self._accepted.get(key)
        # Each request and subscription has an id of its own; only a query has several users.
        is_shared = key.kind == QUERY and accepted is not None and accepted.is_waiting
        users = accepted.users + 1 if accepted is not None and is_shared else 1
        self._accepted[key] = Accepted(command, True, users, reason)
        self._waiting[key] = None

    def _remove_executed(self, key: Key) -> None:
        """Remove an executed command. A waiting one of this key never ran, so it stays."""
        if key not in self._waiting:
            self._accepted.pop(key, None)

    def _discard(self, key: Key) -> None:
        self._accepted.pop(key, None)
        self._waiting.pop(key, None)

    def _waiting_keys(self, command: Command) -> tuple[Key, ...]:
        """The keys of the waiting commands that ``command`` removes."""
        kinds = _REMOVING.get(type(command), ())
        if not kinds:
            return ()
        name = next(iter(msgspec.structs.astuple(command)))
        return tuple(key for key in self._waiting if key.kind in kinds and name in _spellings(key))


def _execute_again(command: Command, engine: Engine) -> Any:
    """Execute ``command`` and return its result. If its streams have evicted samples after the
    moment at which it begins, it begins with the oldest samples that they keep."""
    match command:
        case RequestEvent() | Subscribe() | SubscribeToFeature() | RegisterQuery():

            def begin_at(since: Beginning) -> Any:
                return msgspec.structs.replace(command, since=str(since)).apply(engine)

            return start_from_retained(parse_beginning(command.since), begin_at)
        case _:
            return command.apply(engine)


def _without_name(command: Command) -> Command:
    """The command without the name that the engine chose, so that equal requests compare equal."""
    if isinstance(command, RegisterQuery) and command.name:
        return msgspec.structs.replace(command, name="")
    return command


def query_view(waiting: WaitingCommand) -> QueryView:
    """The view of a waiting query. If this program cannot parse its text, kind and form are
    empty."""
    command = waiting.command
    assert isinstance(command, RegisterQuery)
    try:
        query = parse_registered(command.text)
    except LanguageError:
        query = None
    usual = "bag" if query is None else usual_semantics(query)
    options = Options(command.semantics or usual, command.bounds, command.origin, command.report)
    submission = Submission(
        command.text.strip(), options, command.strategy, parse_beginning(command.since)
    )
    registration = (
        Registration(0, submission, "", "", "")
        if query is None
        else Registration.of(0, submission, query)
    )
    return registration.view(waiting.key.name, "waiting", waiting.reason, waiting.users)


def _spellings(key: Key) -> Iterable[str]:
    """The spellings of the name that users may write."""
    if key.kind == "template":
        return key.name, shorten(key.name), local_name(key.name)
    if key.kind == "ontology":
        return key.name, ontology_graph(key.name).value
    return (key.name,)


def _defined_keys(command: Command) -> tuple[Key, ...]:
    """The keys of the objects that ``command`` defines; empty for a text with errors."""
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
                return _keys_in_text(command)
            except LanguageError:
                return ()


def _keys_in_text(command: Command) -> tuple[Key, ...]:
    """The keys of the objects that a text defines. Raises `LanguageError`."""
    match command:
        case RegisterTemplate(text=text):
            return (Key("template", parse_any_template(text).name),)
        case Annotate(ssl=ssl) | RegisterAnnotatedTransformation(ssl=ssl):
            return tuple(
                Key("annotation" if isinstance(each, ast.StreamDeclaration) else _UNIT, each.name)
                for each in parse_ssl(ssl)
            )
        case _:
            return ()


def _split(command: Command) -> Iterator[tuple[Key, Command]]:
    """Split ``command`` into commands that each define one object, so that users can remove each
    by its name."""
    keys = _defined_keys(command)
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
            # No command removes it. The digest makes equal commands one.
            digest = hashlib.blake2b(encode_command(command), digest_size=8).hexdigest()
            yield Key("command", digest), command

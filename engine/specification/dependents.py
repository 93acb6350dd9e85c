"""Which units stop when insertions are given up, and who needs one that must not stop
([Introspection15 §3.2]).

Nothing is changed here: `apply` asks before it acts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping

from ..configuration.configuration import Configuration
from ..units.base import ComputationalUnit
from ..units.violations import SUFFIX

Users = Callable[[str, str], tuple[str, ...]]
"""Who uses a unit (its name) and its stream by name: requests, subscriptions, KPL."""


def leaving(
    configuration: Configuration,
    given_up: Mapping[ComputationalUnit, int],
    kept: Collection[ComputationalUnit],
) -> tuple[ComputationalUnit, ...]:
    """The units that stop, readers first, if ``given_up`` have so many users less and nothing
    stops that is ``kept``. Cost: O(units that stop and their inputs)."""
    lost = Counter(dict(given_up))
    gone: dict[ComputationalUnit, None] = {}
    todo = list(given_up)
    while todo:
        unit = todo.pop()
        if unit in gone or unit in kept or unit.users > lost[unit]:
            continue
        gone[unit] = None
        for source in unit.inputs:
            producer = configuration.units.get(source.name)
            if producer is not None and producer.output is source:
                lost[producer] += 1
                todo.append(producer)
    return tuple(gone)


def needing(
    configuration: Configuration,
    unit: ComputationalUnit,
    gone: Collection[ComputationalUnit],
    users: Users,
    inserted: Callable[[ComputationalUnit], Iterable[str]],
) -> tuple[str, ...]:
    """Who needs ``unit`` when ``gone`` have stopped: ``users`` of it and of what is made from it,
    and insertions (``inserted``, by unit); else the units that read it."""
    named: dict[str, None] = {}
    anonymous: dict[str, None] = {}
    seen = {unit}
    todo = [unit]
    while todo:
        last = todo.pop()
        found = (*users(last.name, last.output.name), *inserted(last))
        named.update(dict.fromkeys(found))
        for reader in configuration.units.values():
            if last.output in reader.sources and reader not in seen and reader not in gone:
                seen.add(reader)
                todo.append(reader)
                if last is unit:
                    anonymous[reader.name] = None
        for process in configuration.readers.values():
            if last.output in process.inputs:
                named.update(dict.fromkeys(users(process.name, "") or (process.name,)))
    return tuple(named or anonymous)


def used_by_name(
    configuration: Configuration, unit: ComputationalUnit, users: Users
) -> tuple[str, ...]:
    """Who uses the stream of a unit without being counted: subscriptions to it as it is, readers
    of what its policy refused and of what came too late."""
    told = (unit.output.name + SUFFIX, *configuration.late.belonging_to(unit.output.name))
    there = (name for name in told if name in configuration.streams)
    readers = (reader for name in there for reader in configuration.readers_of(name))
    using = (user for name in told for user in users("", name))
    return (*users("", unit.output.name), *using, *readers)

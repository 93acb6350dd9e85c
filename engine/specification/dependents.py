"""Determines the units that stop when insertions are removed, and the users of a unit
([Introspection15 §3.2]). `specifications` calls this before it changes anything.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping

from ..configuration.configuration import Configuration
from ..units.base import ComputationalUnit
from ..units.violations import SUFFIX

Users = Callable[[str, str], tuple[str, ...]]
"""Returns the users of a unit (its name) and of its stream: requests, subscriptions, KPL."""


def stopping_units(
    configuration: Configuration,
    losing: Mapping[ComputationalUnit, int],
    kept: Collection[ComputationalUnit],
) -> tuple[ComputationalUnit, ...]:
    """Return the units that stop, readers first, when the units in ``losing`` lose that number of
    users; those in ``kept`` do not stop. Cost: O(units that stop and their inputs)."""
    lost = Counter(dict(losing))
    stopping: dict[ComputationalUnit, None] = {}
    todo = list(losing)
    while todo:
        unit = todo.pop()
        if unit in stopping or unit in kept or unit.users > lost[unit]:
            continue
        stopping[unit] = None
        for source in unit.inputs:
            producer = configuration.units.get(source.name)
            if producer is not None and producer.output is source:
                lost[producer] += 1
                todo.append(producer)
    return tuple(stopping)


def remaining_users(
    configuration: Configuration,
    unit: ComputationalUnit,
    stopping: Collection[ComputationalUnit],
    users: Users,
    inserted: Callable[[ComputationalUnit], Iterable[str]],
) -> tuple[str, ...]:
    """Return the names of the users of ``unit`` after ``stopping`` have stopped: ``users`` and
    insertions (``inserted``) of it and of its readers; without any, the units that read it."""
    named: dict[str, None] = {}
    anonymous: dict[str, None] = {}
    seen = {unit}
    todo = [unit]
    while todo:
        last = todo.pop()
        found = (*users(last.name, last.output.name), *inserted(last))
        named.update(dict.fromkeys(found))
        for reader in configuration.units.values():
            if last.output in reader.sources and reader not in seen and reader not in stopping:
                seen.add(reader)
                todo.append(reader)
                if last is unit:
                    anonymous[reader.name] = None
        for process in configuration.readers.values():
            if last.output in process.inputs:
                named.update(dict.fromkeys(users(process.name, "") or (process.name,)))
    return tuple(named or anonymous)


def uncounted_users(
    configuration: Configuration, unit: ComputationalUnit, users: Users
) -> tuple[str, ...]:
    """Return the users that `ComputationalUnit.users` does not count: subscriptions to the stream
    itself, and readers of its violations and late samples."""
    names = (unit.output.name + SUFFIX, *configuration.late.belonging_to(unit.output.name))
    there = (name for name in names if name in configuration.streams)
    readers = (reader for name in there for reader in configuration.readers_of(name))
    using = (user for name in names for user in users("", name))
    return (*users("", unit.output.name), *using, *readers)

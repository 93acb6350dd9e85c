"""How much of each kind there may be: looked at here, before the engine is called.

What is there already may be changed while a quota is reached; only what makes more is refused,
with 403: waiting does not help, as it would after 429, and there is room on the disk, as there is
not at 507. A text that makes several things may pass a quota by what it makes, once.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

from ..engine.engine import Engine
from ..engine.errors import UnknownTemplate
from .problems import Problem
from .settings import Settings


@dataclass(frozen=True, slots=True)
class Quota:
    """One kind of things: the setting that bounds it, and how to make room."""

    setting: str
    things: str
    remove: str


STREAMS = Quota("max_streams", "streams", "DELETE /streams/{name}")
TEMPLATES = Quota("max_templates", "templates", "DELETE /templates/{name}")
REQUESTS = Quota(
    "max_requests",
    "event requests, subscriptions, queries and inserted units",
    "DELETE /events/{id}, /subscriptions/{id} or /queries/{name}",
)
DECLARATIONS = Quota("max_declarations", "declarations in KPL", "DELETE /kpl/{name}")

MAKES: Mapping[str, Collection[Quota]] = {
    "PUT /streams/{name}": (STREAMS,),
    "POST /templates": (TEMPLATES,),
    "PUT /templates/{name:path}": (TEMPLATES,),
    "POST /events": (REQUESTS,),
    "POST /subscriptions": (REQUESTS,),
    "POST /queries": (REQUESTS,),
    "POST /specifications": (REQUESTS,),
    "POST /kpl": (DECLARATIONS, STREAMS),
}
"""What each route may make; POST /annotations asks with the names that it has read."""


class Quotas:
    """Refuses what would make more than the settings allow."""

    def __init__(self, engine: Engine, settings: Settings) -> None:
        self._engine = engine
        engine.before_demand(self.check_demand)
        self._limits = {
            quota: int(getattr(settings, quota.setting))
            for quota in (STREAMS, TEMPLATES, REQUESTS, DECLARATIONS)
        }
        self._there: dict[str, Callable[[str], bool]] = {
            "PUT /streams/{name}": engine.has_stream,
            "PUT /templates/{name:path}": self._has_template,
        }

    def check(self, route: str, parameters: Mapping[str, str]) -> None:
        """Raises a 403 `Problem` if ``route`` would make one thing too many. Cost: O(1)."""
        for quota in MAKES.get(route, ()):
            if self._is_full(quota):
                there = self._there.get(route)
                if there is None or not there(parameters["name"]):
                    raise self._reached(quota)

    def check_demand(self) -> None:
        """Raises a 403 `Problem` if there may be no further stream. The engine asks, before it
        makes one because a name means late samples or violations: names stand in many texts."""
        if self._is_full(STREAMS):
            raise self._reached(STREAMS)

    def check_streams(self, names: Collection[str]) -> None:
        """Raises a 403 `Problem` if streams of these names would be too many."""
        new = sum(not self._engine.has_stream(name) for name in set(names))
        if new and self._count(STREAMS) + new > self._limits[STREAMS]:
            raise self._reached(STREAMS)

    def _is_full(self, quota: Quota) -> bool:
        return self._count(quota) >= self._limits[quota]

    def _count(self, quota: Quota) -> int:
        totals = self._engine.totals()
        return int(getattr(totals, quota.setting.removeprefix("max_")))

    def _has_template(self, name: str) -> bool:
        try:
            self._engine.template(name)
        except UnknownTemplate:
            return False
        return True

    def _reached(self, quota: Quota) -> Problem:
        return Problem(
            403,
            "quota reached",
            f"there are {self._count(quota)} {quota.things}; "
            f"{quota.setting} is {self._limits[quota]}",
            hint=f"remove what is not needed ({quota.remove}), "
            f"or start the service with a larger DYKNOW_{quota.setting.upper()}",
        )

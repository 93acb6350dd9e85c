"""Quotas of streams, templates, requests and so on, checked before the engine is called.

While a quota is reached, the service refuses requests that create something, but not changes. The
status is 403: waiting does not help, as after 429, and the disk is not full, as at 507. A text that
creates several things may exceed a quota by these, once.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

from ...engine.engine import Engine
from ...engine.model.errors import UnknownTemplate, UnknownTransformation
from ..config.settings import Settings
from ..http.problems import Problem


@dataclass(frozen=True, slots=True)
class Quota:
    """The limit of one kind: its setting, its name in messages, and the way to make room."""

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
TRANSFORMATIONS = Quota("max_transformations", "transformations", "DELETE /transformations/{name}")
ONTOLOGIES = Quota("max_ontologies", "ontologies", "DELETE /ontologies/{name}")
QUOTAS = (STREAMS, TEMPLATES, REQUESTS, DECLARATIONS, TRANSFORMATIONS, ONTOLOGIES)

MAKES: Mapping[str, Collection[Quota]] = {
    "PUT /streams/{name}": (STREAMS,),
    "POST /templates": (TEMPLATES,),
    "PUT /templates/{name:path}": (TEMPLATES,),
    "POST /events": (REQUESTS,),
    "POST /subscriptions": (REQUESTS,),
    "POST /queries": (REQUESTS,),
    "POST /specifications": (REQUESTS,),
    "POST /kpl": (DECLARATIONS, STREAMS),
    "POST /transformations": (TRANSFORMATIONS,),
    "PUT /transformations/{name}": (TRANSFORMATIONS,),
}
"""The kinds that each route may create. POST /annotations, /transformations and /ontologies call
`Quotas` themselves, with the names in their bodies."""


class Quotas:
    """Refuses requests that would create more than the settings allow."""

    def __init__(self, engine: Engine, settings: Settings) -> None:
        self._engine = engine
        engine.before_demand(self.check_demand)
        self._limits = {quota: int(getattr(settings, quota.setting)) for quota in QUOTAS}
        self._there: dict[str, Callable[[str], bool]] = {
            "PUT /streams/{name}": engine.has_stream,
            "PUT /templates/{name:path}": self._has_template,
            "PUT /transformations/{name}": self._has_transformation,
        }

    def check(self, route: str, parameters: Mapping[str, str]) -> None:
        """Raises a 403 `Problem` if ``route`` would exceed a quota."""
        for quota in MAKES.get(route, ()):
            if self._is_full(quota):
                there = self._there.get(route)
                if there is None or not there(parameters["name"]):
                    raise self._reached(quota)

    def check_demand(self) -> None:
        """Raises a 403 `Problem` if the quota of streams is reached. The engine calls it before it
        creates a stream of late samples or violations, which any text may name."""
        if self._is_full(STREAMS):
            raise self._reached(STREAMS)

    def check_streams(self, names: Collection[str]) -> None:
        """Raises a 403 `Problem` if new streams of these names would exceed the quota."""
        self._check_new(STREAMS, names, self._engine.has_stream)

    def check_transformations(self, names: Collection[str]) -> None:
        """The same check for transformations."""
        self._check_new(TRANSFORMATIONS, names, self._has_transformation)

    def check_ontology(self, name: str) -> None:
        """The same check for an ontology, which replaces one of its name."""
        self._check_new(ONTOLOGIES, [name], self._engine.ontology.has_ontology)

    def _check_new(
        self, quota: Quota, names: Collection[str], is_there: Callable[[str], bool]
    ) -> None:
        new = sum(not is_there(name) for name in set(names))
        if new and self._count(quota) + new > self._limits[quota]:
            raise self._reached(quota)

    def _is_full(self, quota: Quota) -> bool:
        return self._count(quota) >= self._limits[quota]

    def _count(self, quota: Quota) -> int:
        totals = self._engine.totals()
        return int(getattr(totals, quota.setting.removeprefix("max_")))

    def _has_transformation(self, name: str) -> bool:
        try:
            self._engine.transformations.get(name)
        except UnknownTransformation:
            return False
        return True

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

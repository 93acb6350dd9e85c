"""How much of each kind there may be: looked at here, before the engine is called.

What is there already may be changed while a quota is reached; only what makes more is refused,
with 403: waiting does not help, as it would after 429, and there is room on the disk, as there is
not at 507. A text that makes several things may pass a quota by what it makes, once.
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
TRANSFORMATIONS = Quota("max_transformations", "transformations", "DELETE /transformations/{name}")
ONTOLOGIES = Quota(
    "max_ontologies", "ontologies", "none can be: replace one, POST /ontologies?name=IRI"
)
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
"""What each route may make; POST /annotations, /transformations and /ontologies ask with the names
that they have read."""


class Quotas:
    """Refuses what would make more than the settings allow."""

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
        """Raises a 403 `Problem` if ``route`` would make one thing too many."""
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
        self._check_new(STREAMS, names, self._engine.has_stream)

    def check_transformations(self, names: Collection[str]) -> None:
        """The same of transformations."""
        self._check_new(TRANSFORMATIONS, names, self._has_transformation)

    def check_ontology(self, name: str) -> None:
        """The same of an ontology; one of this name is replaced."""
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

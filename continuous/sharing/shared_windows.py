"""Windows that many queries read: their evaluator returns one value per window for all of them.

Subclasses: `template_instances` (instances of a template), `similar_queries` (queries that differ
in constants).
"""

from __future__ import annotations

from abc import abstractmethod

from ...languages.csparql.ast import ContinuousQuery, StreamOperator, TimeWindow
from ..algebra.options import Options
from ..algebra.plan import Blank, Construct, Order, Query, expressions_of, walk
from ..algebra.volatile_functions import is_volatile
from ..evaluation.windowed_evaluator import WindowedEvaluator
from ..windows.grid import Schedule
from ..windows.window_schedule import EvaluateWindows
from .cohorts import JoinedCohort
from .instance_results import InstanceResults, InstancesInBulk


def own_windows(query: ContinuousQuery, schedule: Schedule, options: Options) -> str:
    """Return why the windows or reports of a query depend on when it started, so that it cannot
    share them; "" if they do not."""
    if query.operator is not StreamOperator.RSTREAM:
        return f"{query.operator} compares results with those before, of its own"
    if options.report != "non-empty":
        return f"what it reports ({options.report}) depends on when it began"
    if not all(isinstance(one.window, TimeWindow) for one in schedule.windows):
        return "what is in a window that counts or lasts depends on when it began"
    return ""


def own_solutions(query: Query) -> str:
    """Return why a query's solutions may differ from those of others in the same windows, or ""."""
    nodes = walk(query.plan)
    if any(isinstance(node, Order) for node in nodes):
        return "ORDER BY orders the solutions of one query"
    if any(is_volatile(each) for node in nodes for each in expressions_of(node)):
        return "it asks for what is another value each time"
    head = query.head
    if isinstance(head, Construct) and any(isinstance(p, Blank) for t in head.template for p in t):
        return "its head names blank nodes by the solutions before"
    return ""


class SharedWindows(WindowedEvaluator[InstanceResults | InstancesInBulk]):
    """The windows of ``query`` over named inputs, with the results of many queries.

    Windows that are due at once are evaluated in one pass if all queries are of one cohort.
    """

    @abstractmethod
    def remove(self, instance: int) -> None:
        """Remove a query by its number; raises ``KeyError`` if there is none."""

    @property
    @abstractmethod
    def only_cohort(self) -> JoinedCohort | None:
        """The cohort of all queries; None if there are several, or none that is joined."""

    def _in_bulk(self) -> EvaluateWindows | None:
        return None if self.only_cohort is None else self._close_many

    def _close_many(self, ends: list[int]) -> tuple[int, bool] | None:
        cohort = self.only_cohort
        results = None if cohort is None else cohort.in_bulk(ends)
        if results is None:
            return None
        self._in_a_row = 0
        self._results.append(results)
        # See `_evaluate`.
        return len(results.spans), True

    @abstractmethod
    def explain(self) -> str:
        """Describe what is shared, and how it is computed."""

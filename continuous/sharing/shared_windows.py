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
from .instance_results import InstanceResults


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


class SharedWindows(WindowedEvaluator[InstanceResults]):
    """The windows of ``query`` over named inputs, with the results of many queries."""

    @abstractmethod
    def remove(self, instance: int) -> None:
        """Remove a query by its number; raises ``KeyError`` if there is none."""

    @abstractmethod
    def explain(self) -> str:
        """Describe what is shared, and how it is computed."""

"""Windows that many queries read: rows and watermarks in, one value a window out for all of them.

What is computed over them is the business of `template_instances` (of a template) and
`similar_queries` (queries that differ in constants).
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
    """Why what is in the windows of a query, or which it reports, is its own: it depends on when
    the query began. "" where it does not."""
    if query.operator is not StreamOperator.RSTREAM:
        return f"{query.operator} compares results with those before, of its own"
    if options.report != "non-empty":
        return f"what it reports ({options.report}) depends on when it began"
    if not all(isinstance(one.window, TimeWindow) for one in schedule.windows):
        return "what is in a window that counts or lasts depends on when it began"
    return ""


def own_solutions(query: Query) -> str:
    """Why the solutions of a query are its own, in the same windows as others; "" where not."""
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
        """Forget a query, by its number; raises ``KeyError`` if it is not there."""

    @abstractmethod
    def explain(self) -> str:
        """What is shared, and how it is computed."""

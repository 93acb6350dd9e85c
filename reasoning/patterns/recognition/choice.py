"""The evaluator of a plan."""

from __future__ import annotations

from ..evaluation.all_rows import AllRows
from ..evaluation.evaluator import Evaluator
from ..evaluation.store import SMALLEST
from ..plans.limits import DEFAULT_LIMITS, Limits
from ..plans.plan import PatternPlan, PlanError, Selection
from ..sequences.next_rows import NextRows
from ..sequences.repeated_rows import RepeatedRows
from ..sequences.run_packing import sequence_network
from ..sequences.trend_packing import pack_trends
from ..sequences.trend_products import TrendProducts
from ..sequences.trend_sums import TrendSums


def evaluator_of(
    plan: PatternPlan,
    *,
    is_ordered: bool = True,
    limits: Limits = DEFAULT_LIMITS,
    capacity: int = SMALLEST,
) -> Evaluator:
    """Return a new evaluator of a plan. ``is_ordered``: rows come in order of their ends; only
    plans without repetition under any match may have other rows.

    Raises `PlanError`: the plan cannot be evaluated, or not in any order.
    """
    if plan.selection is not Selection.ANY_MATCH:
        kind: type[NextRows | RepeatedRows | TrendProducts | TrendSums] = NextRows
    elif plan.trends:
        is_free = pack_trends(plan, sequence_network(plan)).is_free(plan)
        kind = TrendProducts if is_free else TrendSums
    elif any(each.is_kleene for each in plan.elements):
        kind = RepeatedRows
    else:
        return AllRows(plan, is_ordered=is_ordered, limits=limits, capacity=capacity)
    if not is_ordered:
        raise PlanError("events that follow each other are only known of rows in order")
    return kind(plan, limits=limits, capacity=capacity)

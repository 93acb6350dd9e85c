"""The evaluator of a plan."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, TypeAlias

from ..evaluation.all_rows import AllRows
from ..evaluation.evaluator import Evaluator
from ..evaluation.part_rows import PartRows
from ..evaluation.store import SMALLEST
from ..plans.limits import DEFAULT_LIMITS, Limits
from ..plans.plan import PatternPlan, PlanError, Selection
from ..sequences.next_rows import NextRows, PartNextRows
from ..sequences.repeated_rows import PartRepeatedRows, RepeatedRows
from ..sequences.run_packing import sequence_network
from ..sequences.trend_packing import pack_trends
from ..sequences.trend_products import PartTrendProducts, TrendProducts
from ..sequences.trend_sums import PartTrendSums, TrendSums

_OfSequences: TypeAlias = type[NextRows | RepeatedRows | TrendProducts | TrendSums]
_IN_PARTS: Final[Mapping[_OfSequences, _OfSequences]] = {
    NextRows: PartNextRows,
    RepeatedRows: PartRepeatedRows,
    TrendProducts: PartTrendProducts,
    TrendSums: PartTrendSums,
}


def evaluator_of(
    plan: PatternPlan,
    *,
    is_ordered: bool = True,
    limits: Limits = DEFAULT_LIMITS,
    capacity: int = SMALLEST,
    part: str | None = None,
) -> Evaluator:
    """Return a new evaluator of a plan. ``is_ordered``: rows come in order of their ends; only
    plans without repetition under any match may have other rows. ``part``: the column that numbers
    the part of a row, for an evaluator that is `InParts`.

    Raises `PlanError`: the plan cannot be evaluated, or not in any order.
    """
    if plan.selection is not Selection.ANY_MATCH:
        kind: _OfSequences = NextRows
    elif plan.trends:
        is_free = pack_trends(plan, sequence_network(plan)).is_free(plan)
        kind = TrendProducts if is_free else TrendSums
    elif any(each.is_kleene for each in plan.elements):
        kind = RepeatedRows
    else:
        rows = AllRows if part is None else PartRows
        return rows(plan, is_ordered=is_ordered, limits=limits, capacity=capacity, part=part)
    if not is_ordered:
        raise PlanError("events that follow each other are only known of rows in order")
    chosen = kind if part is None else _IN_PARTS[kind]
    return chosen(plan, limits=limits, capacity=capacity, part=part)

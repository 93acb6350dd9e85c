"""Windows that are due at once, evaluated in one pass (docs/explanation/design/0012).

The aggregate gives one relation with the solutions of all windows. Its column `END` says which
window a row belongs to. The steps above it work row by row, so they only have to keep that column.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ..algebra.expressions import Const, Var
from ..algebra.plan import Ask, Blank, Construct, Head, Order, Project, Select, Slice
from ..columns.budget import BudgetExceeded
from ..columns.relation import NeedsOxigraph
from ..operators.executor import Step, run
from ..operators.result_forms import END, finish_batch
from ..operators.results import ResultBatch
from .execution import Execution

ROWS: Final = 4096
"""With more rows a window than this, one pass over several windows saves nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class BulkPlan:
    """Steps over the solutions of an aggregate for several windows, and the result form.

    Law: the results are those of the windows one by one. Cost: a few hundred calls of numpy per
    pass, a few nanoseconds per pane, window and group. Memory: see `bulk_aggregation.CELLS`.
    """

    steps: tuple[Step, ...]
    head: Select | Construct
    execution: Execution

    @classmethod
    def of(cls, execution: Execution, head: Head) -> BulkPlan | str:
        """Return the plan for several windows, or why each window is evaluated by itself."""
        shape = execution.shape
        if isinstance(shape, str):
            return "they are not computed incrementally"
        if execution.windows.options.report != "non-empty":
            return "windows without content are evaluated too"
        steps = execution.steps
        if steps is None or any(isinstance(step, Slice) for step in steps):
            return "a step above the aggregate needs all solutions of one window"
        if not isinstance(head, Select) and not _by_row(head):
            return "the order of a window's triples may depend on all of its solutions"
        assert not isinstance(head, Ask)
        return cls(tuple(map(_with_end, steps)), head, execution)

    def results(self, ends: Sequence[int]) -> ResultBatch | None:
        """Return the results of the windows that end at some of ``ends``, from the first on; None
        if they must be evaluated one by one. Afterwards the aggregate has followed them."""
        execution = self.execution
        static, terms = execution.static, execution.static.terms
        try:
            found = execution.in_bulk(ends, ROWS)
            if found is None:
                return None
            bulk, aggregated = found
            relation = run(self.steps, aggregated, terms)
            windows = relation.columns[END].values
            # The limit is that of one window, so the largest one decides.
            rows = int(np.bincount(windows, minlength=1).max())
            terms.budget.check_result(rows)
        except (NeedsOxigraph, BudgetExceeded):
            # The window that is concerned raises it again, by itself.
            return None
        # Until here the state is unchanged, so that the windows may close one by one instead.
        execution.follow(bulk)
        spans = [execution.windows.span(end) for end in bulk.ends]
        return finish_batch(self.head, relation, windows, spans, static.terms)


def _with_end(step: Step) -> Step:
    """Return ``step`` so that it keeps the column `END` and the order of windows."""
    match step:
        case Project(variables, child):
            return Project((*variables, END), child)
        case Order(keys, child):
            return Order(((Var(END), False), *keys), child)
        case _:
            return step


def _by_row(head: Head) -> bool:
    """Whether the triples of a head and their order depend on each solution alone."""
    if not isinstance(head, Construct):
        return False
    places = [place for triple in head.template for place in triple]
    named = all(isinstance(predicate, Const) for _, predicate, _ in head.template)
    return named and not any(isinstance(place, Blank) for place in places)

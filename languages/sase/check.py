"""Checks SASE+ patterns against the ontology (SPEC §8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from ...ontology.vocabulary import Vocabulary
from ..mtl.ast import Slot, Symbol
from ..object_cache import ObjectCache
from ..ontology_names import OntologyNames
from ..rewriting import rewritten
from . import ast
from .checked import CheckedPattern, CheckedTemplate
from .conditions import Conditions
from .parameters import Parameters
from .parts import Parts
from .results import Results, objects_of


def check_sase(pattern: ast.Pattern, source: str, vocabulary: Vocabulary) -> CheckedPattern:
    """Return the meaning of ``parse_sase(source)``. Raises `LanguageError` with the place of the
    first part, name or condition that is wrong."""
    return _checked(pattern, (), OntologyNames(source, vocabulary))[0]


@ObjectCache
def check_sase_template(template: ast.PatternTemplate, vocabulary: Vocabulary) -> CheckedTemplate:
    """Return the meaning of a template. A parameter with a sort, or one that an ``id`` must equal,
    stands for objects; another one stands for a value. Raises `LanguageError`."""
    names = OntologyNames(template.source, vocabulary)
    checked, parameters = _checked(template.pattern, template.slots, names)
    return CheckedTemplate(tuple(map(parameters.slot, template.slots)), checked)


def _checked(
    pattern: ast.Pattern, slots: Sequence[Slot], names: OntologyNames
) -> tuple[CheckedPattern, Parameters]:
    parts = Parts(pattern, names)
    parameters = Parameters(parts, slots)
    conditions = Conditions(parts, parameters)
    for each in pattern.where:
        conditions.check(each, is_having=False)
    for each in pattern.having:
        conditions.check(each, is_having=True)

    text = replace(pattern, items=pattern.items or objects_of(pattern))
    objects = tuple(parameters.objects.values())
    checked = CheckedPattern(text, names.source, parts.types, objects, parts.stream)
    _check_strategy(checked, parts)
    Results(parts, conditions).check(checked)

    def with_iri(node: Any) -> Any:
        is_name = isinstance(node, Symbol)
        return Symbol(f"<{names.object(node.text, node.span)}>", node.span) if is_name else node

    text = replace(
        text,
        where=rewritten(text.where, with_iri),
        having=rewritten(text.having, with_iri),
        items=rewritten(text.items, with_iri),
    )
    return replace(checked, text=text), parameters


def _check_strategy(checked: CheckedPattern, parts: Parts) -> None:
    pattern = checked.text
    strategy = pattern.strategy or ast.Strategy.ANY_MATCH
    kleene = next((part for part in pattern.parts if part.is_kleene), None)
    if strategy is ast.Strategy.PARTITION_CONTIGUITY and not any(
        isinstance(each, ast.Equivalence) for each in pattern.where
    ):
        raise parts.error(
            "partition_contiguity needs an attribute that divides the events",
            pattern.parts[0].span,
            "write it in brackets: `WHERE partition_contiguity [id]`",
        )
    if checked.is_over_matches:
        if strategy is not ast.Strategy.ANY_MATCH:
            raise parts.error(
                f"aggregates over all matches need skip_till_any_match, not {strategy}",
                pattern.items[0].span,
                "aggregate the events of each match: `count(a[])`, `sum(a[].x)`",
            )
        absent = next((part for part in pattern.parts if part.is_negated), None)
        if absent:
            raise parts.error(
                f"aggregates over all matches do not know whether `{absent.name}` is absent",
                absent.span,
                "return the matches, or omit the part",
            )
        if pattern.having or pattern.limit is not None:
            raise parts.error(
                "HAVING and LIMIT are about matches, and this query has none as results",
                pattern.having[0].span if pattern.having else pattern.span,
                "omit them; a second query can filter the results of this one",
            )
    elif kleene and strategy is ast.Strategy.ANY_MATCH and pattern.limit is None:
        raise parts.error(
            f"under skip_till_any_match `{kleene.name}` has exponentially many matches",
            kleene.span,
            "aggregate over them, such as `RETURN COUNT(*)`, bound the matches of an event by "
            "`LIMIT 100`, or write `WHERE skip_till_next_match`",
        )

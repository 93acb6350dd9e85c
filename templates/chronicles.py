"""Chronicles as event templates: a request's arguments in place of the parameters (SPEC §8)."""

from __future__ import annotations

from collections.abc import Sequence

from pyoxigraph import Variable

from ..languages.chronicle import ChronicleTemplate, check_chronicle_template, with_arguments
from ..ontology.vocabulary import Vocabulary
from ..rdf.dictionary import Term
from ..reasoning.patterns.chronicle_plans import chronicle_query
from ..reasoning.patterns.query import PatternQuery
from .slots import bind_slots


def bound_chronicle(
    template: ChronicleTemplate, arguments: Sequence[Term | Variable], vocabulary: Vocabulary
) -> PatternQuery:
    """Return the chronicle of a template with ``arguments``, one for each parameter.

    A variable leaves the objects of a parameter free. Raises `ArgumentError`, and `LanguageError`
    as `chronicle_query` does.
    """
    checked = check_chronicle_template(template, vocabulary)
    bound = bind_slots(template, checked.slots, arguments)
    chronicle = with_arguments(checked.chronicle, bound.values, bound.objects)
    return chronicle_query(chronicle, template.source, vocabulary)

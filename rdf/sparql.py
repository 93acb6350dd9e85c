"""Whether a text is SPARQL 1.1, by Oxigraph's parser, without anything being evaluated.

Called by the rooms above before a text is kept or evaluated: `ontology.query_guard` for users'
queries, `languages.csparql` for continuous ones. A text that is nested deeply or very long may
overflow the parser's stack and end the process: who takes texts of strangers bounds both before.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from pyoxigraph import NamedNode, Store


def check_sparql(
    text: str,
    prefixes: Mapping[str, str],
    custom_functions: Mapping[NamedNode, Callable[..., Any]] | None = None,
) -> None:
    """Raises ``SyntaxError`` for a text that is no query. Cost: a parse.

    Oxigraph has no parse by itself, and evaluating is work even over nothing: VALUES multiply, BIND
    makes texts as long as it likes, and ASK does all that at once. But arguments that contradict
    each other are refused right after the text was read.
    """
    try:
        Store().query(
            text,
            prefixes=dict(prefixes),
            custom_functions=dict(custom_functions or {}),
            use_default_graph_as_union=True,
            default_graph=NamedNode("urn:dyknow:none"),
        )
    except SyntaxError:
        raise
    except ValueError as error:
        if "default_graph" not in str(error):
            raise SyntaxError(str(error)) from error
        return
    raise AssertionError("Oxigraph evaluates what it was only to read")

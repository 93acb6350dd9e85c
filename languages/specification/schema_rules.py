"""The rules of the schema, with plain messages ([Introspection15 §3.2]).

The schema (`specification.xsd`) reports neither the column of an error nor a remedy, and its list
of errors costs quadratic time. This module therefore checks the rules first, and the schema has the
last word (`parser`). Law: this module refuses exactly the texts that the schema refuses
(`tests/languages/test_specification.py`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

from ...streams.sample import LONGEST_NAME
from ..errors import LanguageError, Span
from ..hints import did_you_mean
from .document import Document, Element, Value
from .markup import BLANKS, NAMESPACE, Attribute, abbreviate

_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_.\-]*")


@dataclass(frozen=True, slots=True)
class _Kind:
    """The rules for one kind of element; ``title`` is its name in messages.

    ``references`` are attributes that name existing things, so any text that is not blank is
    allowed; ``verbatim`` ones are any text. The others are names.
    """

    title: str
    holds: Mapping[str, str] = field(default_factory=dict)
    required: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    references: tuple[str, ...] = ()
    verbatim: tuple[str, ...] = ()


_UNIT_HOLDS: Final = {"cu": "unit", "stream": "stream", "parameter": "parameter"}
_KINDS: Final = {
    "specification": _Kind("`specification`", {"insertions": "insertions", "removals": "removals"}),
    "insertions": _Kind("`insertions`", {"cu": "unit"}),
    "removals": _Kind("`removals`", {"cu": "removal"}),
    "unit": _Kind("`cu`", _UNIT_HOLDS, required=("type",), optional=("name",)),
    "stream": _Kind("`stream`", required=("name",), references=("name",)),
    "parameter": _Kind("`parameter`", required=("name", "value"), verbatim=("value",)),
    "removal": _Kind("a removed `cu`", optional=("name", "type"), references=("name",)),
}
_ELEMENTS: Final = ("specification", "insertions", "removals", *_UNIT_HOLDS)
_MISSING: Final = {
    ("unit", "type"): 'name its transformation: `type="gps"`',
    ("stream", "name"): 'name the stream to read: `name="positions"`',
    ("parameter", "name"): 'name the parameter: `name="baseline"`',
    ("parameter", "value"): 'state its value: `value="5s"`; `value=""` is the empty text',
}
_NAME_OR_TYPE: Final = 'name a unit or stream, `name="result"`, or a transformation, `type="gps"`'


def first_violation(document: Document) -> LanguageError | None:
    """Return the first violation of the schema; None if there is none."""
    try:
        _Walk(document).walk()
    except LanguageError as error:
        return error
    return None


@dataclass(slots=True)
class _Walk:
    document: Document
    # The kind of each element so far, and the first element of each unique key.
    kinds: list[str] = field(default_factory=list)
    first: dict[tuple[str, int | None, str], Element] = field(default_factory=dict)

    def walk(self) -> None:
        for element in self.document.elements:
            kind = self.kind(element)
            self.kinds.append(kind)
            self.attributes(element, kind)
            self.once(element, kind)
            if element.text is not None:
                raise self.error(
                    f"{_KINDS[kind].title} contains text",
                    Span(element.text, element.text + 1),
                    "put names and values into attributes; a comment is `<!-- … -->`",
                )

    def error(self, message: str, span: Span, hint: str) -> LanguageError:
        return LanguageError(message, self.document.source, span, hint)

    # -- elements ----------------------------------------------------------------------------

    def kind(self, element: Element) -> str:
        """Return the kind of the element, by its name and parent."""
        if element.parent is None:
            return self.root(element)
        self.namespace(element)
        parent = _KINDS[self.kinds[element.parent]]
        if element.name in parent.holds:
            return parent.holds[element.name]
        name, span = abbreviate(element.name), element.tag.name_span
        holds = f"{parent.title} contains {_enumerate(parent.holds)}"
        if element.name in _ELEMENTS:
            raise self.error(f"`{name}` is not allowed in {parent.title}", span, holds)
        hint = did_you_mean(element.name, parent.holds) or holds
        raise self.error(f"`{name}` is not an element of a specification", span, hint)

    def root(self, element: Element) -> str:
        if element.name != "specification":
            raise self.error(
                f"`{abbreviate(element.name)}` is not a specification",
                element.tag.name_span,
                f"the first element is `specification`, of the namespace `{NAMESPACE}`",
            )
        self.namespace(element)
        return "specification"

    def namespace(self, element: Element) -> None:
        if element.namespace == NAMESPACE:
            return
        name, namespace = abbreviate(element.tag.name), abbreviate(element.namespace)
        where = f"in the namespace `{namespace}`" if namespace else "in no namespace"
        prefix = self.document.elements[0].tag.name.rpartition(":")[0]
        if element.parent is None:
            hint = f'write xmlns{":" if prefix else ""}{prefix}="{NAMESPACE}"'
        elif element.namespace or not prefix:
            hint = f"elements of a specification are in `{NAMESPACE}`"
        else:
            hint = f"write `{abbreviate(f'{prefix}:{element.name}')}`"
        raise self.error(f"`{name}` is {where}", element.tag.name_span, hint)

    # -- attributes --------------------------------------------------------------------------

    def attributes(self, element: Element, kind: str) -> None:
        rules = _KINDS[kind]
        allowed = (*rules.required, *rules.optional)
        for attribute in element.foreign:
            raise self.unknown(attribute, attribute.name.rpartition(":")[2], element, kind)
        for name, value in element.attributes.items():
            if name not in allowed:
                raise self.unknown(value.place, name, element, kind)
        for name in rules.required:
            if name not in element.attributes:
                raise self.error(
                    f"{rules.title} has no `{name}`", element.tag.name_span, _MISSING[kind, name]
                )
        for name, value in element.attributes.items():
            if name not in rules.verbatim:
                self.value(name, value, kind)
        if kind == "removal":
            self.removal(element)

    def unknown(
        self, attribute: Attribute, name: str, element: Element, kind: str
    ) -> LanguageError:
        """Return the error for an attribute that the kind lacks; ``name`` has no prefix."""
        rules = _KINDS[kind]
        allowed = (*rules.required, *rules.optional)
        if name in allowed and name not in element.attributes:
            hint = f"write `{name}`, without a prefix"
        else:
            near = "" if name in allowed else did_you_mean(name, allowed)
            hint = near or f"it has {_enumerate(allowed) if allowed else 'none'}"
        message = f"{rules.title} has no attribute `{abbreviate(attribute.name)}`"
        return self.error(message, attribute.span, hint)

    def value(self, name: str, value: Value, kind: str) -> None:
        text = value.text.strip(BLANKS)
        place = value.place.value
        if not text:
            optional = kind == "unit" and name == "name"
            raise self.error(
                f"`{name}` is empty",
                Span(place.start - 1, place.end + 1),
                "leave it out, and DyKnow assigns a name" if optional else "write a name",
            )
        if name not in _KINDS[kind].references and _NAME.fullmatch(text) is None:
            raise self.error(
                f"`{abbreviate(text)}` is not a name",
                place,
                "a name is letters a-z, digits, `_`, `.` and `-`, and begins with a letter or `_`",
            )
        if name not in _KINDS[kind].references and len(text) > LONGEST_NAME:
            raise self.error(
                f"`{abbreviate(text)}` has {len(text)} characters",
                place,
                f"a name has at most {LONGEST_NAME}",
            )

    def removal(self, element: Element) -> None:
        if not element.attributes:
            raise self.error(
                "a removed `cu` has neither `name` nor `type`",
                element.tag.name_span,
                _NAME_OR_TYPE,
            )
        if len(element.attributes) == 2:
            raise self.error(
                "a removed `cu` has both `name` and `type`",
                list(element.attributes.values())[1].place.span,
                "give one of the two; two removals are two `cu`",
            )

    # -- uniqueness -------------------------------------------------------------------------

    def once(self, element: Element, kind: str) -> None:
        """Check uniqueness: of each section, of unit names, and of a unit's parameters."""
        span = element.tag.name_span
        match kind:
            case "insertions" | "removals":
                if line := self.first_line((kind, None, ""), element):
                    hint = f"put all into the one of line {line}"
                    raise self.error(f"`{kind}` occurs twice", span, hint)
            case "unit" if "name" in element.attributes:
                value = element.attributes["name"]
                name = value.text.strip(BLANKS)
                if line := self.first_line((kind, None, name), element):
                    message = f"two units have the name `{abbreviate(name)}`"
                    hint = f"the first is on line {line}; `stream` reads the same unit once more"
                    raise self.error(message, value.place.value, hint)
            case "parameter":
                value = element.attributes["name"]
                name = value.text.strip(BLANKS)
                if line := self.first_line((kind, element.parent, name), element):
                    message = f"`{abbreviate(name)}` is set twice"
                    hint = f"line {line} sets it already; a unit has each parameter once"
                    raise self.error(message, value.place.value, hint)
            case _:
                pass

    def first_line(self, key: tuple[str, int | None, str], element: Element) -> int:
        """Return the line of the first element with this key; 0 if it is this one."""
        first = self.first.setdefault(key, element)
        if first is element:
            return 0
        return self.document.source.count("\n", 0, first.tag.span.start) + 1


def _enumerate(names: Iterable[str]) -> str:
    """Return `` `a`, `b` and `c` ``; ``nothing`` if empty."""
    *others, last = [f"`{name}`" for name in names] or ["nothing"]
    return f"{', '.join(others)} and {last}" if others else last

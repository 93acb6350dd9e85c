"""Entity tags of answers, and the conditions on them (RFC 9110 §8.8.3, §13.1)."""

from __future__ import annotations

from hashlib import sha256


def entity_tag(content: bytes) -> str:
    """The tag of an answer with this content. It is weak: a compressed answer has it, too."""
    return f'W/"{sha256(content).hexdigest()[:32]}"'


def names(condition: str | None, etag: str) -> bool:
    """Whether ``If-Match`` or ``If-None-Match`` names the tag. Weak tags are as good as strong
    ones, since all that differs between them is the compression."""
    tags = [_opaque(tag.strip()) for tag in (condition or "").split(",")]
    return "*" in tags or _opaque(etag) in tags


def _opaque(tag: str) -> str:
    # Some clients leave the quotes out.
    return tag.removeprefix("W/").strip('"')

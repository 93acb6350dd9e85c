"""What was read of the last texts is found again: of short ones many, of long ones few."""

from __future__ import annotations

import pytest

from dyknow.languages.text_cache import CHARACTERS, LEAST, TextCache


def counted() -> tuple[TextCache[list[str]], list[str]]:
    read: list[str] = []

    @TextCache
    def parse(text: str) -> list[str]:
        """Words."""
        read.append(text)
        if not text.strip():
            raise ValueError("no words")
        return text.split()

    return parse, read


def test_a_text_is_read_once() -> None:
    parse, read = counted()
    assert parse("a b") is parse("a b")
    assert read == ["a b"]
    assert parse.__doc__ == "Words."


def test_what_cannot_be_read_is_read_again() -> None:
    parse, read = counted()
    for _ in range(2):
        with pytest.raises(ValueError, match="no words"):
            parse(" ")
    assert len(read) == 2


def test_many_short_texts_are_remembered_and_few_long_ones() -> None:
    parse, read = counted()
    short = [f"{number:<100}" for number in range(CHARACTERS // LEAST)]
    for text in short * 2:
        parse(text)
    assert read == short
    # The one that was asked for last stays, also if it is longer than all may be.
    parse(short[0])
    parse("x" * (CHARACTERS - LEAST))
    assert parse(short[0]) == ["0"]
    assert read.count(short[0]) == 1
    parse(short[1])
    assert read.count(short[1]) == 2
    longest = "y" * (2 * CHARACTERS)
    assert parse(longest) is parse(longest)
    parse(short[0])
    assert read.count(short[0]) == 2

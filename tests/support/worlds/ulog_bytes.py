"""Writes small PX4 logs by hand (the ULog format), for tests of the reader."""

import struct

MAGIC = b"ULog\x01\x12\x35\x01"


def message(kind: str, payload: bytes) -> bytes:
    return struct.pack("<HB", len(payload), ord(kind)) + payload


def flags() -> bytes:
    return message("B", bytes(8 + 8 + 24))


def form(name: str, *fields: str) -> bytes:
    """``form("attitude", "uint64_t timestamp", "float[4] q")``"""
    return message("F", (name + ":" + "".join(f"{field};" for field in fields)).encode())


def subscribe(number: int, name: str, instance: int = 0) -> bytes:
    return message("A", struct.pack("<BH", instance, number) + name.encode())


def data(number: int, layout: str, *values: object) -> bytes:
    return message("D", struct.pack("<H" + layout, number, *values))


def dropout(milliseconds: int) -> bytes:
    return message("O", struct.pack("<H", milliseconds))


def log(*messages: bytes) -> bytes:
    return MAGIC + struct.pack("<Q", 0) + flags() + b"".join(messages)


NAN, INFINITY = float("nan"), float("inf")

TWO_TOPICS = log(
    form("point", "float x", "int16_t y"),
    form(
        "attitude",
        "uint64_t timestamp",
        "uint64_t timestamp_sample",
        "float[2] q",
        "bool armed",
        "point where",
        "uint64_t big",
        "uint8_t valid",
        "uint8_t[3] _padding0",
    ),
    form("gps", "uint64_t timestamp", "double lat"),
    subscribe(0, "attitude"),
    subscribe(1, "gps"),
    subscribe(2, "gps", 1),
    data(0, "QQff?fhQB", 1000, 900, 0.5, NAN, True, 1.5, -2, 2**63, 1),
    data(1, "Qd", 1500, 58.5),
    dropout(40),
    data(0, "QQff?fhQB", 2000, 0, INFINITY, 0.25, False, 2.5, 3, 7, 0),
    data(0, "QQff?fhQB", 2000, 1950, 1.0, 2.0, False, 2.5, 3, 7, 0),
    data(1, "Qd", 2500, NAN),
    data(2, "Qd", 2400, 1.0),
    dropout(2),
)
"""Two instances of gps; attitude with arrays, a nested type, ties, no values and two dropouts."""

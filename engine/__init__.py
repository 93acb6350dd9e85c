"""The running system: streams, units, requests, and the semantics manager that mirrors them.

The engine is a deterministic step: samples and ticks go in with their time, samples come out of
the streams. It reads no clock and starts no thread ([Introspection15 §3], SPEC §6).
"""

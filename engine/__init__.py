"""The running system: streams, units, requests, and the semantics manager that mirrors them.

The engine is deterministic: samples and ticks enter with their time, and samples leave by the
streams. It reads no clock and starts no thread ([Introspection15 §3], SPEC §6).
"""

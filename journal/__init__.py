"""The data directory: a log of records that survive, checkpoints, and their lock.

Knows bytes only; what they mean is said in engine/durability/commands and
engine/durability/checkpoint.
"""

"""States of many objects from samples of features (SPEC §1 "State synchronization", §8)."""

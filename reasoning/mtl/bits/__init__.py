"""Verdicts over states that objects share: tables of bits, in compiled loops."""

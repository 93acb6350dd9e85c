"""Event templates: registration, instantiation, what they need ([Events14 §IV.B, §V.B])."""

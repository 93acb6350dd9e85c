"""Event templates: registration, instantiation, needs ([Events14 §IV.B, §V.B])."""

"""The running service: its context, metrics, warm-up, live samples, garbage collection."""

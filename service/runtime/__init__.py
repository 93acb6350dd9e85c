"""The service as it runs: its context, metrics, warm-up and live samples."""

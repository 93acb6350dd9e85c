"""Recorded data as streams: one file a format, and tables that come by a pipe."""

"""Requests: events, queries, subscriptions, and the matching that follows changes."""

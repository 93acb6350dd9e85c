"""What people ask for: events, queries, subscriptions, and the matching that follows changes."""

"""The evaluator of one query: window by window, with the way that each part is solved."""

"""The matches of plans whose events follow each other: runs, repetition, trends."""

"""The matches of a plan without repetition, and what all evaluations share."""

"""Commands that are recorded, checkpoints, and the start that does them again."""

"""The routes that answer what runs, how it is, and what could answer a question."""

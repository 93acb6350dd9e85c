"""States of several streams at common times."""

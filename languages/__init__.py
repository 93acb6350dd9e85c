"""The languages that users write: text in, checked values out, errors with line and column.

Each language is a folder with a grammar, an AST of frozen values, a parser, a checker and a
printer. Parsing never resolves names; checking does.
"""

"""Work of which nobody knows how long it takes, in processes that can be ended.

docs/isolation.md says what is limited and what is told.

`child` is what runs there, `worker` one such process as its parent has it, `pool` several of them.
What is asked of them is in `sparql` (queries), `documents` (RDF and what it entails),
`specifications` (XML) and `asking` (Oxigraph, for continuous queries); `messages` is what both
sides say to each other, `elements` how they say a specification.
"""

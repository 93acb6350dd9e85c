"""Work of which nobody knows how long it takes, in processes that can be ended.

docs/explanation/isolation.md says what is limited and what is told.

`worker_main` is what runs there, `worker` one such process as its parent has it, `pool` several of
them. What is asked of them is in `sparql` (queries), `rdf_documents` (RDF and what it entails),
`specifications` (XML) and `oxigraph_client` (Oxigraph, for continuous queries); `messages` is what
both sides say to each other, `xml_elements` how they say a specification.
"""

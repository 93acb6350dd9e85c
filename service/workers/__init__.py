"""Work of unknown duration, in worker processes that can be killed.

docs/explanation/isolation.md lists the limits and the errors.

A worker runs `worker_main`, which executes `jobs`; `fork_server` makes its process. `worker` is its
handle in the service; `pool` has several. `sparql` (queries), `rdf_documents` (RDF and its
entailments), `specifications` (XML) and `oxigraph_client` (Oxigraph, for continuous queries) send
jobs. `messages` is the protocol between both sides, with `xml_elements` for specifications.
"""

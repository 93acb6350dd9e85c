"""RDF as it is: texts of statements, and streams that hold statements."""

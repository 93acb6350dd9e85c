"""The shipped ontologies, opened once; a library gets an ontology of its own."""

import pytest

from dyknow.ontology.ontology import Ontology


@pytest.fixture(scope="session")
def vocabulary():
    return Ontology.open().vocabulary


@pytest.fixture
def ontology():
    return Ontology.open()
